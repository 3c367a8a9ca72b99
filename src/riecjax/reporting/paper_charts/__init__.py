"""The figures of the paper, from many roads where it shows one."""
