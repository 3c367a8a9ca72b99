"""From a file to named columns of numbers, and from those to a record."""
