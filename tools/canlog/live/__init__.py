"""Shows a log that still grows, or a live bus, in a browser: feeds, the stream and its server."""
