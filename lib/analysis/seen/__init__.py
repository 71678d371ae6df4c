"""What tiles of the photograph show and receive, and where its edges put things."""
