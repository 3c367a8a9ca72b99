"""From normal equations to parameters with their uncertainty."""
