"""§3.3 How light spreads between patches: form factors, the light balance, mirrors and glossy surfaces."""
