"""Units of length that a model may be drawn in. Planning reads this without NumPy."""

METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048}
