"""What `coilcal bench` measures; `scripts/benchmarks` uses the same parts."""
