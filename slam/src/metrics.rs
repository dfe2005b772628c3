//! Scores: F-score and ADD-S.
