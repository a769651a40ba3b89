"""ECG recordings from the files that clinics and archives have: a file a format."""
