"""The networks and their files: encoder, radiance field, volume rendering; nothing is trained here."""
