/* One step of the simulator in C: what `vttig_jax.control.simulation.case` does in a period of the controller
 * for the rigid plant with prescribed motion in straight lines, two quantised encoders, the
 * tracking filter and the paper's controller, all metrics included. Same arithmetic, line by line;
 * see the Python for what it means. The flanks are closed: the first order of each shaft.
 *
 * Lanes lie side by side (structure of arrays) in blocks of LANES, a block small enough for the
 * cache; the lane is the innermost loop. Numbers that all lanes share are scalars. What has not
 * happened yet is NEVER instead of NaN, which -ffast-math does not know. FIELDS and OWN are the
 * numbers of fields that the caller thinks there are.
 */
#include <math.h>

#ifndef LANES
#define LANES 64
#endif
#define PIECES 6
#define EDGES (PIECES + 2) /* the starts of the pieces, and where the two standstills begin */
#define NEVER 1e300

typedef double Row[LANES];

/* What differs between the lanes: where a piece or standstill starts, s, and the angle there. */
typedef struct {
    Row start[EDGES], begins[EDGES];
    Row duration_s, braking_s, turn_s;
} Own;

/* What all lanes share. */
typedef struct {
    double period, other;
    double speed[EDGES], acceleration[EDGES];
    double ratio, offset[2], cosine[2][2], sine[2][2], closing[2];
    double inertia, coulomb, load, fading, restitution;
    double fastest, braking, stroke, resolution, queued, yields;
    double correct_angle, correct_speed, correct_acceleration; /* over the innovation */
    double threshold, least_speed, margin;
    double map_offset, map_cosine[2], map_sine[2], map_closing, map_ratio; /* of the gap */
    double driving_count, driven_count;
} Shared;

typedef struct {
    Row angle, speed, offset, drift, side;
    Row lower, upper, lower_slope, upper_slope;
    Row wanted, rate, reached, queue;
    Row seen_angle, seen_speed, seen_acceleration;
    Row closes, shift;
    Row samples, total, highest, lowest, first, before, after;
    Row gap, crossing, crossing_s, detection, detection_s, false_closings;
    Row left, lacking, opened, retracted, asked, interference, travel, farthest, commanded;
    Row blocked, blocked_s;
    Row carrier, largest_jump, early_jump, wrong_travel;
    Row output_start, output_error, output_squares, lost;
} State;

#ifdef FIELDS
_Static_assert(sizeof(State) == FIELDS * sizeof(Row), "fields of the state");
_Static_assert(sizeof(Own) == OWN * sizeof(Row), "numbers of a lane");
_Static_assert(sizeof(Shared) == SHARED * sizeof(double), "numbers of all lanes");
#endif

typedef struct { double sine, cosine; } Wave;
typedef struct { double lower, upper, lower_slope, upper_slope; } Flanks;
typedef struct { double c0, c1, c2, c3; } Cubic;

#define INLINE static inline __attribute__((always_inline))

INLINE double least(double a, double b) { return a < b ? a : b; }
INLINE double most(double a, double b) { return a > b ? a : b; }
INLINE double within(double x, double low, double high) { return least(most(x, low), high); }
INLINE double sign(double x) { return x > 0 ? 1.0 : x < 0 ? -1.0 : 0.0; }

INLINE Wave sincos_(double x)
{
    const double turns = rint(x * 0.6366197723675814);
    const double r = (x - turns * 1.5707963267923333) - turns * 2.563344151594519e-12;
    const double t = r * r;
    double s = 1.5918129294866608e-10, c = -1.1382632425521717e-11;
    s = s * t + -2.5051131845003624e-08;
    s = s * t + 2.755731610255244e-06;
    s = s * t + -0.00019841269836758574;
    s = s * t + 0.008333333333330948;
    s = s * t + -0.16666666666666666;
    c = c * t + 2.08761462684032e-09;
    c = c * t + -2.7557317271729793e-07;
    c = c * t + 2.480158729876569e-05;
    c = c * t + -0.0013888888888887398;
    c = c * t + 0.041666666666666664;
    const double sine = r + r * t * s, cosine = 1.0 - 0.5 * t + t * t * c;
    const double quadrant = turns - 4.0 * floor(turns * 0.25);
    const int odd = (quadrant == 1.0) | (quadrant == 3.0);
    const double one = odd ? cosine : sine, other = odd ? sine : cosine;
    const int back = (quadrant == 1.0) | (quadrant == 2.0);
    return (Wave){quadrant >= 2.0 ? -one : one, back ? -other : other};
}

/* First order of both shafts, and its slope by the driving angle. */
INLINE double sum(const double *cosine, const double *sine, Wave one, Wave two)
{
    return (cosine[0] * one.cosine + sine[0] * one.sine)
        + (cosine[1] * two.cosine + sine[1] * two.sine);
}

INLINE double slope_of(const double *cosine, const double *sine, double ratio, Wave one, Wave two)
{
    return (sine[0] * one.cosine - cosine[0] * one.sine)
        + ratio * (sine[1] * two.cosine - cosine[1] * two.sine);
}

INLINE double at(Cubic c, double u) { return c.c0 + u * (c.c1 + u * (c.c2 + u * c.c3)); }
INLINE double slope(Cubic c, double u) { return c.c1 + u * (2 * c.c2 + 3 * u * c.c3); }

INLINE Cubic cubic(double start, double end, double start_rate, double end_rate, double step)
{
    const double a = start_rate * step, b = end_rate * step, change = end - start;
    return (Cubic){start, a, 3 * change - 2 * a - b, a + b - 2 * change};
}

INLINE double not_zero(double x) { return x == 0 ? 1.0 : x; }

INLINE double first_root(Cubic c)
{
    double u = within(c.c0 / not_zero(c.c0 - at(c, 1.0)), 0.0, 1.0);
    for (int i = 0; i < 2; i++) {
        const double value = at(c, u), rate = slope(c, u), bend = 2 * c.c2 + 6 * u * c.c3;
        const double below = rate * rate - 0.5 * value * bend;
        u = within(u - value * rate / not_zero(below), 0.0, 1.0);
    }
    return u;
}

INLINE double reading(double angle, double count)
{
    return floor(angle * (1.0 / count) + 0.5) * count;
}

/* The period that starts at `time`, in every lane of a block, in loops over the lanes: what the
 * controller decides, what happens, and metrics. In one loop GCC carries conditions of one over
 * into the other, and gives up on vectors.
 */
static __attribute__((noinline)) void period(State *restrict s, const Own *restrict own,
                                             const Shared *restrict p, double time)
{
    const double step = p->period, rate = 1.0 / step, then = time + step;
    const double ratio = p->ratio, other = p->other;
    const double closing_sum = p->closing[0] + p->closing[1], per_rad = 1.0 / closing_sum;
    const double brake = p->braking * step;
    Row commands, readings, begins, meets, gaps, angles, runs_on;

#pragma GCC ivdep
    for (int l = 0; l < LANES; l++) {
        /* readings, observer */
        const double angle = s->angle[l];
        const double driving = reading(angle, p->driving_count);
        const double driven = reading(ratio * angle + s->offset[l], p->driven_count);
        const double was_speed = s->seen_speed[l], was_acceleration = s->seen_acceleration[l];
        const double foreseen =
            s->seen_angle[l] + step * (was_speed + 0.5 * step * was_acceleration);
        const double innovation = driving - foreseen;
        const double seen_speed =
            was_speed + step * was_acceleration + p->correct_speed * innovation;
        const double seen_acceleration = was_acceleration + p->correct_acceleration * innovation;
        s->seen_angle[l] = foreseen + p->correct_angle * innovation;
        s->seen_speed[l] = seen_speed;
        s->seen_acceleration[l] = seen_acceleration;

        /* controller */
        const int moves = fabs(seen_speed) > p->least_speed;
        const double along = sign(seen_speed) * seen_acceleration;
        const int slows = moves & (along < -p->threshold), gains = moves & (along > p->threshold);
        const int was_closing = s->closes[l] != 0;
        const int closing = slows | (was_closing & !gains);
        const Wave map_one = sincos_(driving), map_two = sincos_(p->map_ratio * driving);
        const double believed =
            p->map_offset + sum(p->map_cosine, p->map_sine, map_one, map_two);
        const double wish = believed * p->map_closing - p->margin;
        const double was_shift = s->shift[l];
        const double shift = (closing & !was_closing) ? most(wish, 0.0) : was_shift;
        const double command = closing ? shift : 0.0;
        s->closes[l] = closing ? 1.0 : 0.0;
        s->shift[l] = shift;

        readings[l] = driven - ratio * driving;
        commands[l] = command;
    }

#pragma GCC ivdep
    for (int l = 0; l < LANES; l++) {
        /* metrics of the output; the motion is the reference, so that it deviates by the offset */
        const double output = s->offset[l], so_far = s->output_error[l];
        const double deviation = fabs(output - s->output_start[l]);
        const double lower = s->lower[l], upper = s->upper[l];
        const double squares = s->output_squares[l], speed = s->speed[l];
        const int counts = (time <= own->duration_s[l]) & (s->blocked[l] == 0);
        const int back = counts & (time > own->turn_s[l]);
        const double travelled = back ? step * fabs(speed) : 0.0;
        s->output_error[l] = back ? most(so_far, deviation) : so_far;
        s->output_squares[l] = squares + (counts ? deviation * deviation : 0.0);
        s->lost[l] += travelled * fabs(output - (other > 0 ? lower : upper));
    }

#pragma GCC ivdep
    for (int l = 0; l < LANES; l++) {
        const double angle = s->angle[l], side = s->side[l], command = commands[l];
        const double queue = s->queue[l];
        /* command on its way */
        double target = p->queued != 0 ? queue : command;
        target = within(target, 0.0, p->stroke);
        target = p->resolution > 0 ? floor(target / p->resolution) * p->resolution : target;
        s->queue[l] = command;

        /* metrics of the sample */
        const double wanted = s->wanted[l], reached = s->reached[l];
        const double duration = own->duration_s[l], turn = own->turn_s[l];
        const double samples = s->samples[l], total = s->total[l];
        const double highest = s->highest[l], lowest = s->lowest[l], was_first = s->first[l];
        const double before = s->before[l], after = s->after[l], left = s->left[l];
        const double gap = s->gap[l], crossing = s->crossing[l], crossing_s = s->crossing_s[l];
        const double detection = s->detection[l], detection_s = s->detection_s[l];
        const double lacking = s->lacking[l], asked = s->asked[l], commanded = s->commanded[l];
        const double interference = s->interference[l], farthest = s->farthest[l];
        const int was_retracted = s->retracted[l] != 0, was_opened = s->opened[l] != 0;
        const int was_blocked = s->blocked[l] != 0;
        const double blocked_s = s->blocked_s[l];

        const int crossed = gap != NEVER, free_to_go = !was_blocked;
        const int counts = (time <= duration) & free_to_go;
        const int braking = time >= own->braking_s[l];
        const double first = samples == 0 ? readings[l] : was_first;
        const double error = readings[l] - first;
        const int asks = counts & (command > 0);
        const int starts = asks & (commanded == 0);
        const int detects = asks & braking & (time < turn) & (detection == NEVER);
        const int turns = counts & (time >= turn - 0.5 * step) & (time < duration)
            & (left == NEVER);
        const int opens = counts & (time > turn) & (command == 0);
        const double open = s->upper[l] - s->lower[l] - closing_sum * reached;
        const int opened = opens | was_opened;
        const int retracted = was_retracted | (starts & was_opened);
        s->samples[l] = samples + (counts ? 1.0 : 0.0);
        s->total[l] = total + (counts ? error : 0.0);
        s->highest[l] = counts ? most(highest, error) : highest;
        s->lowest[l] = counts ? least(lowest, error) : lowest;
        s->first[l] = first;
        s->before[l] = (counts & !crossed & (side == -other)) ? error : before;
        s->after[l] = (counts & crossed & (after == NEVER)) ? error : after;
        s->detection[l] = detects ? angle : detection;
        s->detection_s[l] = detects ? time : detection_s;
        s->false_closings[l] += (starts & !braking) ? 1.0 : 0.0;
        s->left[l] = turns ? open : left;
        s->lacking[l] = turns ? target - wanted : lacking;
        s->retracted[l] = retracted ? 1.0 : 0.0;
        s->opened[l] = opened ? 1.0 : 0.0;
        s->asked[l] = (counts & !was_opened) ? most(asked, command) : asked;
        s->commanded[l] = counts ? command : commanded;

        /* motion */
        double start = 0.0, ahead = 0.0, ahead_speed = 0.0, ahead_acceleration = 0.0;
        for (int e = 0; e < EDGES; e++) {
            const double edge = own->start[e][l], begins = own->begins[e][l];
            const double speed_there = p->speed[e], gaining = p->acceleration[e];
            const int begun = then >= edge;
            start = begun ? edge : start;
            ahead = begun ? begins : ahead;
            ahead_speed = begun ? speed_there : ahead_speed;
            ahead_acceleration = begun ? gaining : ahead_acceleration;
        }
        const double since = then - start;
        ahead += since * (ahead_speed + since * (0.5 * ahead_acceleration));
        ahead_speed += since * ahead_acceleration;

        /* flanks */
        const Wave one = sincos_(ahead), two = sincos_(ratio * ahead);
        Flanks f;
        f.lower = p->offset[0] + sum(p->cosine[0], p->sine[0], one, two);
        f.upper = p->offset[1] + sum(p->cosine[1], p->sine[1], one, two);
        f.lower_slope = slope_of(p->cosine[0], p->sine[0], ratio, one, two);
        f.upper_slope = slope_of(p->cosine[1], p->sine[1], ratio, one, two);

        /* actuator */
        const double closed = (f.upper - f.lower) * per_rad;
        const double away = target - wanted, far = fabs(away);
        const double more = floor(0.5 * (sqrt(1 + far * (8 * rate / brake)) - 1));
        const double stops = far * rate / (more + 1) + 0.5 * brake * more;
        const double change = sign(away) * least(p->fastest, stops) - s->rate[l];
        const double slide_speed = s->rate[l] + within(change, -brake, brake);
        const double now_wanted = wanted + step * slide_speed;
        const double now_reached = least(now_wanted, most(closed, 0.0));
        const int stuck = (p->yields == 0) & (now_reached < least(reached, now_wanted));
        const double slides = (now_reached - reached) * rate;
        s->wanted[l] = now_wanted;
        s->rate[l] = slide_speed;
        s->reached[l] = now_reached;

        /* walls at both ends of the step, free flight between them */
        const double speed = s->speed[l], offset = s->offset[l], drift = s->drift[l];
        const double shut0 = p->closing[0], shut1 = p->closing[1];
        const double low = s->lower[l] + shut0 * reached, high = s->upper[l] - shut1 * reached;
        const double low_rate = s->lower_slope[l] * speed + shut0 * slides;
        const double high_rate = s->upper_slope[l] * speed - shut1 * slides;
        const double then_low = f.lower + shut0 * now_reached;
        const double then_high = f.upper - shut1 * now_reached;
        const double then_low_rate = f.lower_slope * ahead_speed + shut0 * slides;
        const double then_high_rate = f.upper_slope * ahead_speed - shut1 * slides;
        const double turning = ratio * speed + drift;
        const double push = p->fading * turning - p->load;
        const double stop = push + (p->inertia / step) * turning;
        const double slowing =
            (push - within(stop, -p->coulomb, p->coulomb)) * (1.0 / p->inertia);
        const double turned = step * (turning + 0.5 * step * slowing);
        const double free = offset + turned - ratio * (ahead - angle);
        const double free_drift = drift + step * slowing - ratio * (ahead_speed - speed);

        /* impact */
        const int below = free <= then_low, above = free >= then_high, hit = below | above;
        const Cubic lows = cubic(low, then_low, low_rate, then_low_rate, step);
        const Cubic highs = cubic(high, then_high, high_rate, then_high_rate, step);
        const Cubic wall = {below ? lows.c0 : highs.c0, below ? lows.c1 : highs.c1,
                            below ? lows.c2 : highs.c2, below ? lows.c3 : highs.c3};
        const double inwards = below ? 1.0 : -1.0;
        const Cubic flight = cubic(offset, free, drift, free_drift, step);
        const Cubic apart = {inwards * (flight.c0 - wall.c0), inwards * (flight.c1 - wall.c1),
                             inwards * (flight.c2 - wall.c2), inwards * (flight.c3 - wall.c3)};
        const double share = first_root(apart), rest = (1 - share) * step;
        const double bounced =
            (slope(wall, share) - inwards * p->restitution * slope(apart, share)) * rate;
        const double pull = (free_drift - drift) * rate;
        const double bounce = at(wall, share) + rest * (bounced + 0.5 * rest * pull);
        const double flank = below ? then_low : then_high;
        const double flank_rate = below ? then_low_rate : then_high_rate;
        const int both = below & above, on_a = side < 0, on_b = side > 0, flies = !(on_a | on_b);
        const int same = (both & !flies) | (below & on_a) | (above & on_b & (below ^ 1))
            | (flies & (hit ^ 1));
        const double touched = below ? -1.0 : above ? 1.0 : 0.0;
        const double carries = same ? side : touched;
        const int falls = (below & (bounce <= then_low)) | ((below ^ 1) & (bounce >= then_high));
        const int stays = hit & (same | falls);
        const double met = both ? -side : same ? 0.0 : touched;
        const Cubic way = cubic(angle, ahead, speed, ahead_speed, step);
        const double met_angle = at(way, share), met_gap = at(highs, share) - at(lows, share);
        const double landed = stays ? flank : hit ? bounce : free;
        s->angle[l] = ahead;
        s->speed[l] = ahead_speed;
        s->offset[l] = within(landed, then_low, then_high);
        s->drift[l] = stays ? flank_rate : hit ? bounced + rest * pull : free_drift;
        s->side[l] = stays ? carries : 0.0;
        s->lower[l] = f.lower;
        s->upper[l] = f.upper;
        s->lower_slope[l] = f.lower_slope;
        s->upper_slope[l] = f.upper_slope;

        /* metrics of the step */
        const int still = (then <= duration) & free_to_go;
        begins[l] = angle;
        meets[l] = met;
        gaps[l] = met_gap;
        angles[l] = met_angle;
        runs_on[l] = still ? 1.0 : 0.0;
        const int crosses = still & (met == other) & (then > own->braking_s[l]) & !crossed;
        const int jams = still & stuck, reverses = still & !opened;
        const int runs = still & !retracted;
        const double beyond = now_wanted - now_reached;
        s->gap[l] = crosses ? met_gap : gap;
        s->crossing[l] = crosses ? met_angle : crossing;
        s->crossing_s[l] = crosses ? then : crossing_s;
        s->interference[l] = reverses ? most(interference, beyond) : interference;
        s->travel[l] += runs ? fabs(now_reached - reached) : 0.0;
        s->farthest[l] = runs ? most(farthest, now_reached) : farthest;
        s->blocked[l] = (jams | was_blocked) ? 1.0 : 0.0;
        s->blocked_s[l] = jams ? then : blocked_s;
    }

#pragma GCC ivdep
    for (int l = 0; l < LANES; l++) {
        /* metrics of jumps, and of the flank in contact */
        const double met_gap = gaps[l], met = met_gap > 1e-12 ? meets[l] : 0.0;
        const double carrier = s->carrier[l], side = s->side[l], turned = s->angle[l] - begins[l];
        const double largest = s->largest_jump[l], sooner = s->early_jump[l];
        const double wrong = s->wrong_travel[l];
        const int still = runs_on[l] != 0, early = still & (then < own->turn_s[l]);
        const double was_carrier = carrier == 0 ? -other : carrier;
        const double jump = (still & (met == -was_carrier)) ? met_gap : 0.0;
        const double now = met != 0 ? met : side;
        const double now_carries = (still & (now != 0)) ? now : was_carrier;
        s->carrier[l] = now_carries;
        s->largest_jump[l] = most(largest, jump);
        s->early_jump[l] = early ? most(sooner, jump) : sooner;
        s->wrong_travel[l] = wrong + ((early & (now_carries == other)) ? fabs(turned) : 0.0);
    }
}

/* Run periods 0 … periods − 1 of all blocks, one block after the other. */
void run(State *state, const Own *own, const Shared *shared, long blocks, long periods)
{
    for (long block = 0; block < blocks; block++)
        for (long number = 0; number < periods; number++)
            period(&state[block], &own[block], shared, (double)number * shared->period);
}
