"""Non-linear refinement: what the linear stage cannot reach, from its estimate as a start."""
