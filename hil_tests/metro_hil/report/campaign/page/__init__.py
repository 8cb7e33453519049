"""The page of a campaign: its content, its pictures, and the resulting file."""
