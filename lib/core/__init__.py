"""What every stage shares, none of it about pictures: the run of a stage, files, reports, compiled kernels."""
