"""The page itself: markup, style and scripts, put together by `views.report` and `views.server`."""
