"""From one photograph's facts and light to its materials, or to what is wrong."""
