"""Many runs: drives that are rendered and tracked once, and their errors against the ground truth."""
