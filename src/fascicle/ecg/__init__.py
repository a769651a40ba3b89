"""From activation to the twelve-lead ECG."""
