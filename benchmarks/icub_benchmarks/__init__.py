"""icub_benchmarks."""
