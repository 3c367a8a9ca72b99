"""How far estimates can be trusted: blocks of time, covariances, the bootstrap, intervals."""
