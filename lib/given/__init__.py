"""What is given, read and checked: images, cameras and lenses, the model, the transfer function, materials; and rays through it."""
