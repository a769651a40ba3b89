"""The study: settings, durable evaluations, stages, results."""
