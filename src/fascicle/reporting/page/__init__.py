"""One HTML file that tells what a study found: words, figures, and a heart to turn."""
