"""Everything that is known of an answer: estimate, refinement, tests and validation in one."""
