"""A whole line of point-mass trains with its DC network: Green CBTC [Lin] and better laws."""
