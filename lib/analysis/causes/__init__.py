"""What may be wrong with the picture as a whole, or with what is told of it."""
