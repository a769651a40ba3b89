"""The explorer: a page on which a heart, its networks and its ECG follow the hand."""
