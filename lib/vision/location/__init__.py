"""§2.4 for further photographs: where each was taken from, by what is known of the posed ones and of the model."""
