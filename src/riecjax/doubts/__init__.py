"""Whatever else may be amiss with an equation, as columns of it: sensors, and terms that it lacks."""
