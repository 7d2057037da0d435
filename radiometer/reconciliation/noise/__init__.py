"""How far each statistic of a model that is right would scatter, alone and together with others."""
