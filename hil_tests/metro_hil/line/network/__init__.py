"""Controllers in network namespaces of their own, with what a bad radio does between them."""
