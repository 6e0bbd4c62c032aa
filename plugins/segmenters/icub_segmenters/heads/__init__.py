"""On-line heads: classifiers and regressors that are trained in seconds."""
