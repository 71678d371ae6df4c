"""§2.4 Whole poses from corners, where the planes of the facets are too few or too poor to prove one."""
