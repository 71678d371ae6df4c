"""§2.4 The pose that puts the model's edges on those of both photographs."""
