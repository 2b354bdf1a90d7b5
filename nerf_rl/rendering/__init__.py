"""What cameras see of a scene, and where they are mounted; nothing is stored here."""
