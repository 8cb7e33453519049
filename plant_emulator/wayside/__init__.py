"""The rest of the railway, as far as a train can hear it by radio."""
