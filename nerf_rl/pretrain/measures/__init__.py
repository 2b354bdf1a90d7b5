"""What is measured of a frozen encoder: probes, statistics of its latent, figures in words."""
