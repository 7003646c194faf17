"""What several test modules share: slow twins of the kernels, synthetic scans, small logs and batches."""
