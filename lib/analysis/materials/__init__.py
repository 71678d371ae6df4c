"""The reflectance ladder: groups that no diffuse surface explains."""
