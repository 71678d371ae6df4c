"""§3.2 Index buffers: what each pixel shows, how much of it, and whether the analysis may trust it."""
