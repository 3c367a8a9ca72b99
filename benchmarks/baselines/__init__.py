"""What benchmarks are compared with: plain NumPy, SciPy, numba, PySINDy and lmfit."""
