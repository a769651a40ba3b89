"""Activation times of trees and myocardium, one eikonal problem."""
