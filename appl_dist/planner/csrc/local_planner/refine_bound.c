#include "refine_bound.h"

// The next points, and where to go on after each of them. Returns how many; the lanes left over repeat the last point.
static int next_points(int steps, int back, int gap, pose_batch *at, int32_t *back_after, int32_t *gap_after) {
    int count = 0;
    while (count < POSE_BATCH) {
        if (back >= steps) {
            if (gap == 1) break;
            gap /= 2;
            back = gap;
            continue;
        }
        at->step[count] = steps - 1 - back;
        back += gap == REFINE_COARSEST ? REFINE_COARSEST : 2 * gap;
        back_after[count] = back;
        gap_after[count] = gap;
        ++count;
    }
    for (int i = count; i < POSE_BATCH; ++i) at->step[i] = steps - 1;
    return count;
}

// Whether both waves reach every point, given that they reach the last. Cells open to the goal's wave are open to the
// path's, and among open neighbours all are reached if one is; so as a rule no wave has to come here.
static refine_result reached(rollout_planner *p, const motion *m, const rollout_arc *way) {
    int x = -1;
    int y = -1;
    for (int last = way->steps - 1; last >= 0; last -= POSE_BATCH) {
        pose_batch at;
        for (int i = 0; i < POSE_BATCH; ++i) at.step[i] = last > i ? last - i : 0;
        rollout_arc_poses(way, p, m, &at);
        for (int i = 0; i < POSE_BATCH && i <= last; ++i) {
            if (at.known[i] <= 0) return at.known[i] == 0 ? REFINE_ILLEGAL : REFINE_UNDECIDED;
            const int cx = at.cx[i];
            const int cy = at.cy[i];
            const int dx = abs(cx - x);
            const int dy = abs(cy - y);
            const bool linked = dx + dy <= 1 || (dx == 1 && dy == 1 &&
                                                 (wavefront_open(&p->goal, x, cy) || wavefront_open(&p->goal, cx, y)));
            x = cx;
            y = cy;
            if (linked || last - i == way->steps - 1) continue;
            if (wavefront_distance(&p->path, x, y) >= WAVE_LIMIT || wavefront_distance(&p->goal, x, y) >= WAVE_LIMIT)
                return REFINE_ILLEGAL;
        }
    }
    return REFINE_EXACT;
}

refine_result refine_bound(rollout_planner *p, const motion *m, sample_block *b, int lane, double enough,
                           bool or_equal) {
    const grid_frame *g = &p->frame;
    const rollout_arc way = velocity_samples_arc(b, lane);
    pose_batch at;
    int32_t back[POSE_BATCH], gap[POSE_BATCH];
    for (;;) {
        const int count = next_points(way.steps, b->back[lane], b->gap[lane], &at, back, gap);
        if (count == 0) return reached(p, m, &way);
        rollout_arc_poses(&way, p, m, &at);
        rollout_arc_corners(p, &at);
        for (int i = 0; i < count; ++i) {
            if (at.known[i] <= 0) return at.known[i] == 0 ? REFINE_ILLEGAL : REFINE_UNDECIDED;
            if (!wavefront_open(&p->goal, at.cx[i], at.cy[i])) return REFINE_ILLEGAL;
            if (at.corners_known[i] <= 0) return at.corners_known[i] == 0 ? REFINE_ILLEGAL : REFINE_UNDECIDED;
            grid_cell corner[FOOTPRINT_CORNERS];
            for (int k = 0; k < FOOTPRINT_CORNERS; ++k) corner[k] = (grid_cell){at.corner_x[k][i], at.corner_y[k][i]};
            const int outline = footprint_cells_cost(&p->lines, g, p->cost, corner);
            if (outline < 0) return REFINE_ILLEGAL;
            const int centre = p->cost[at.cy[i] * g->w + at.cx[i]];
            const int cost = outline > centre ? outline : centre;
            b->back[lane] = back[i];
            b->gap[lane] = gap[i];
            if (cost <= b->occ[lane]) continue;
            b->occ[lane] = cost;
            b->bound[lane] = total_cost(p, b->path[lane], b->goal[lane], cost);
            if (b->bound[lane] > enough || (or_equal && b->bound[lane] == enough)) return REFINE_BOUNDED;
        }
    }
}

double simulate_cost(rollout_planner *p, const motion *m, double v, double w, rollout *scratch) {
    simulate_again(p, *m, v, w, scratch);
    return scratch->cost >= 0 ? scratch->cost : -1;
}
