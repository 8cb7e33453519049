"""The subcommands of `canlog`."""
