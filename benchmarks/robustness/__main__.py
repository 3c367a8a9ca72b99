"""`python -m benchmarks.robustness`: see `fuzzing`, which the watched processes import by name."""

from benchmarks.robustness.fuzzing import main

if __name__ == "__main__":
    main()
