"""§2 From two photographs and a model to the posed cameras."""
