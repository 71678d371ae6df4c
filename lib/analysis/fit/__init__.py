"""The inverse problem of one photograph: reflectances, lamps and response together, with sigma and evidence."""
