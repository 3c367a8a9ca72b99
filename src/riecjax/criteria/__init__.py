"""Error criteria: which weighted integrals of an equation of motion are made small."""
