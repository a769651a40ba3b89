"""Activation times of trees and myocardium as one coupled eikonal problem."""
