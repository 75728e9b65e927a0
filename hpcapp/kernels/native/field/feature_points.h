// The points around a vertex of the finest lattice, and sums over them, eight lanes at a time.
//
// Point i adds to lane i % 8; the lanes are added up in their order at the end: each instruction set
// gives the same bits.
#pragma once

#include <cstdint>

#include "constants.h"

namespace hpc {

using constants::BASIS, constants::field::PIECES;
using constants::features::HEIGHT, constants::features::MOST;
// Exponents of x, y in a height.
constexpr int TERMS[HEIGHT][2] = {{0, 0}, {1, 0}, {0, 1}, {2, 0}, {1, 1}, {0, 2}};

struct Vec {
  double x, y, z;
};

struct Quadric {
  double c[BASIS];
};

// `[count, padded)` are points at the vertex that weigh nothing.
struct PointsAround {
  int count = 0, padded = 0;
  double at[3][MOST], normal[3][MOST], weight[MOST], total = 0.0;

  Vec normal_of(int i) const { return {normal[0][i], normal[1][i], normal[2][i]}; }
};

// What the points of a piece are to the plane across its axis: x, y in the plane, height over it.
struct PlaneSums {
  double moments[5][5];  // of x^k y^l
  double slopes[3][3];   // of x^k y^l, by the weights of the slopes
  double right[HEIGHT];  // of the height and the slopes, by the terms of `TERMS`
};

// What each point is to each piece of a model.
struct Taken {
  double distance[PIECES][MOST], cost[PIECES][MOST];
  double share[PIECES][MOST];  // the weight in the piece that has it, 0 in others
};

// Sum x^a y^b z^c to moments[a][b][c] for a + b + c < 5, and the normals times 1, x, y, z.
void sum_moments(const PointsAround& points, double (&moments)[5][5][5], double (&flux)[3][4]);

// Return the weighted sum of squared distances to a quadric.
double sum_squares(const PointsAround& points, const Quadric& quadric);

// Sum over the points of a piece, given its axis and two vectors across; `lam` weighs the slopes.
void sum_plane(const PointsAround& points, const double* share, const Vec (&frame)[3], double lam, PlaneSums& sums);

// The cost of each point to a piece: by its normal alone, or by place and normal, along with its distance.
void rate_by_axis(const PointsAround& points, const Vec& axis, double* cost);
void rate_by_piece(const PointsAround& points, const Quadric& piece, double* cost, double* distance);

// Take each point to the cheapest of two or three pieces; sum weights and weighted normals of each, and
// tell whether any point is in another piece than before.
bool take_points(const PointsAround& points, int pieces, Taken& taken, double (&sums)[PIECES][4]);

// Join three distances by max or min (see `types.field.Features`).
void join_distances(const PointsAround& points, const double* a, const double* b, const double* c, unsigned joint,
                    double* joined);

// Return the weighted sum of products of two values of each point.
double sum_products(const PointsAround& points, const double* a, const double* b);

// Return the nearest other point of point i, the first of several as near; i where there is none.
int find_nearest(const PointsAround& points, int i);

}  // namespace hpc
