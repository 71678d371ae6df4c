"""What is given, read and checked: images, cameras, lenses, the model, the transfer function, materials; and rays."""
