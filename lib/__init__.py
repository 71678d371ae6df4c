"""The modules the stages call, named by the field; pipeline.yaml is the table of contents."""
