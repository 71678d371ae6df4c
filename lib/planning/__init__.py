"""What a scene wants and what runs for it: scene.yaml, pipeline.yaml, the plan for Make."""
