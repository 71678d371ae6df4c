"""§2.4, local recognition: objects with a pose of their own, found by their edges in all photographs."""
