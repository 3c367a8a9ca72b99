"""What benchmarks are compared with: plain NumPy, SciPy, numba and PySINDy."""
