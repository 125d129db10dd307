"""The narrative: the steps of the method, in order."""
