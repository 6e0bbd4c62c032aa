"""Feature extractors: pre-trained networks that propose and describe regions."""
