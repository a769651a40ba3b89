"""From a recording to a target: beats, their mean and spread, the QRS window."""
