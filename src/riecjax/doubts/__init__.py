"""Whatever may be amiss with an equation beside its values, as columns of it."""
