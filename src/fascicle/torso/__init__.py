"""The volume conductor around the heart and the lead fields in it."""
