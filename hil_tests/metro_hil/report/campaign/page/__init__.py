"""The page: what it shows, how it is drawn, and the one file that comes out."""
