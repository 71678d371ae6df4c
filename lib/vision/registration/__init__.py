"""§2.4 What the photograph's edges say of a given pose and of where the model's objects stand."""
