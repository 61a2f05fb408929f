"""Many runs: parameters found from data."""
