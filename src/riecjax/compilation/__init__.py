"""Compiled functions that outlive the process which made them.

- `program_key`: what tells a compiled program from another one.
- `program_files`: programs in files, and loading them ahead of their call.
- `kept_jit`: a jit that finds by that key what an earlier process has compiled.
"""
