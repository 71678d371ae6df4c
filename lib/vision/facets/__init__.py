"""§2.3 Planes of matched regions, with their covariance."""
