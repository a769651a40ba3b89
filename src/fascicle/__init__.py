"""Learn a patient's Purkinje network, with its uncertainty, from a heart model and an ECG."""
