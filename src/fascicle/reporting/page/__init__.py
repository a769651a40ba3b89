"""The report of a study as one HTML file: text, figures, and a heart to turn."""
