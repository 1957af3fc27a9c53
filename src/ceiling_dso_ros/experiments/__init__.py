"""Many runs: drives that are rendered and tracked once, and what the truth says of them."""
