"""What came out: errors against truth, the scorecard, the page."""
