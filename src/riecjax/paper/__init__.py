"""The study of Best and Gordon (1999): published numbers and their reproduction."""
