"""Markup, style and scripts of the page that `views.report` and `views.server` assemble."""
