"""What `make bench` compares, one file for each piece of work."""
