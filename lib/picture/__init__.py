"""§3.3 From balanced light to the picture that the camera takes of it."""
