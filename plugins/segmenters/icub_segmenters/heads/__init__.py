"""On-line heads: classifiers and regressors that are trained in a moment."""
