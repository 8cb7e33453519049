"""Multi-frame messages: J1939 transport and ISO-TP, decoded in whole columns."""
