"""Every arm of an ablation: trained, raced, weighed against the claims."""
