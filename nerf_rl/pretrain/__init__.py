"""From a multi-view dataset to a frozen encoder, through a latent-conditioned radiance field."""
