"""Names of the camera's transfer functions, for whoever reads, checks or shows one.

The formulas are in `lib/given/transfer.py`. The names stand apart because planning checks scene.yaml without NumPy.
"""

CURVES = {"srgb": "sRGB"}  # functions without a parameter, and how people write them
OF_LIGHT = ("gamma", "linear", *CURVES, "curve")  # functions of a pixel's light alone
OF_PICTURE = ("linear_per_group", "histogram", "histogram_per_group")  # look at the photograph; fitted as `linear`
KINDS = (*OF_LIGHT, *OF_PICTURE)
