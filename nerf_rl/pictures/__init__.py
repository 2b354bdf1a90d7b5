"""Pictures, videos and pages as files, whatever they show."""
