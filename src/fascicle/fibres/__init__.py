"""Rule-based fibre and sheet directions."""
