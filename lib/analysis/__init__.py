"""§4 From the photograph to reflectances: the inverse problem, its solution, the reflectance ladder."""
