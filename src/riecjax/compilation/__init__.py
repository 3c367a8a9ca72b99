"""Compiled functions that outlive the process which made them.

- `program_key`: what tells a compiled program from another one.
- `kept_jit`: a jit that finds by that key what an earlier process has compiled.
"""
