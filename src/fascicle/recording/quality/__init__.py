"""What a recording's own numbers say about how far it can be trusted."""
