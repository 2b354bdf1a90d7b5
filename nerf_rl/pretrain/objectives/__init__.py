"""What encoders are taught by, as Lightning modules: the radiance field and simpler objectives."""
