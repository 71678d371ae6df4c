"""§2.4 Which part of the model the reconstructed facets show, and from where."""
