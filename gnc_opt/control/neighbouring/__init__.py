"""Plans that are kept up on board: their switches and their end follow what is measured."""
