"""The 17 statements of the paper, each decided from numbers over many roads."""
