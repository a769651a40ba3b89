"""ECG recordings from the files that clinics and archives have: a file a format.

Every format has a function ``read_...(path, options)``. It takes the file and what the user says
about it (`ReadOptions`, which must agree with the file), returns a `RawRecording` with the names
and units that the file has, and raises InputError, whose message begins with the path, when the
file is damaged, truncated or contradictory, or does not say what its numbers mean.
"""
