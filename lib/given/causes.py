"""What may not be as given, by name: causes that may be taken, as `explain` of scene.yaml and materials.json name them.

One table for planning, which reads it without NumPy, and for the fit.
"""

OF_PICTURE = ("curve", "vignetting", "glow", "lamp_lobe")
GEOMETRIC = ("pose", "objects", "lamp_place")  # after which all that rests on camera and model is made again
BUILT = (*OF_PICTURE, *GEOMETRIC)
CAUSES = (*BUILT, "fog")
