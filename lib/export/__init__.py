"""The recovered scene for other programs: glTF, Mitsuba, Radiance, USD, COLMAP, Blender."""
