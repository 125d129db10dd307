"""Description of submaps and verification of their loops."""
