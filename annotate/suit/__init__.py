"""The colour-coded clothing: its palette, how light changes it, how it is learnt."""
