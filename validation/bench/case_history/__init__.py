"""A case history at field scale: ground, release and runout in, the friction of the bed out, with its interval."""
