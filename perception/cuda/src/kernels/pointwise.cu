// Operations on single numbers, and moves of numbers.

KERNEL add(real *y, const real *a, const real *b, unsigned count) {
    map2(y, a, b, count, [](float a, float b) { return a + b; });
}

// Adds a gradient to the sum of a parameter's gradients.
KERNEL accumulate(float *sum, const real *x, unsigned count) {
    map2(sum, sum, x, count, [](float sum, float x) { return sum + x; });
}

KERNEL to_real(real *y, const float *x, unsigned count) {
    map(y, x, count, [](float x, unsigned) { return x; });
}

KERNEL to_float(float *y, const real *x, unsigned count) {
    map(y, x, count, [](float x, unsigned) { return x; });
}

// y = x + addend, whose numbers repeat with `period`.
template <class T>
static __device__ __forceinline__ void add_repeated(
    real *y, const real *x, const T *addend, unsigned count, unsigned period
) {
    if (period % 4) {
        EACH(i, count) store(y, i, load(x, i) + load(addend, i % period));
        return;
    }
    EACH(four, count / 4) {
        Four v = load4(x, 4 * four), w = load4(addend, 4 * four % period);
        #pragma unroll
        for (int k = 0; k < 4; k++)
            v.x[k] += w.x[k];
        store4(y, 4 * four, v);
    }
}

// y may be x.
KERNEL add_bias(real *y, const real *x, const float *bias, unsigned count, unsigned period) {
    add_repeated(y, x, bias, count, period);
}

KERNEL add_table(real *y, const real *x, const real *table, unsigned count, unsigned period) {
    add_repeated(y, x, table, count, period);
}

KERNEL relu(real *y, const real *x, unsigned count) {
    map(y, x, count, [](float x, unsigned) { return fmaxf(x, 0.0f); });
}

// Gradient by the input of relu. by_x may be g.
KERNEL relu_back(real *by_x, const real *x, const real *g, unsigned count) {
    map2(by_x, x, g, count, [](float x, float g) { return x > 0.0f ? g : 0.0f; });
}

KERNEL gelu(real *y, const real *x, unsigned count) {
    map(y, x, count, [](float x, unsigned) { return 0.5f * x * (1.0f + erff(0.70710678f * x)); });
}

KERNEL gelu_back(real *by_x, const real *x, const real *g, unsigned count) {
    map2(by_x, x, g, count, [](float x, float g) {
        float below = 0.5f * (1.0f + erff(0.70710678f * x));
        return g * (below + x * 0.39894228f * expf(-0.5f * x * x));
    });
}

// Multiplies channels by numbers.
KERNEL scale(real *y, const real *x, const float *factors, unsigned count, unsigned width) {
    EACH(i, count) store(y, i, load(x, i) * factors[i % width]);
}

// Appends a token to those of every image; y has `count` numbers of `tokens` tokens an image.
KERNEL append(real *y, const real *x, const real *last, unsigned count, unsigned tokens, unsigned width) {
    EACH(i, count) {
        unsigned token = i / width % tokens, image = i / width / tokens, channel = i % width;
        float v = token + 1 == tokens ? load(last, channel) : load(x, (image * (tokens - 1) + token) * width + channel);
        store(y, i, v);
    }
}

// Gradient by x: that of all tokens but the last. by_x has `count` numbers.
KERNEL append_back(real *by_x, const real *g, unsigned count, unsigned tokens, unsigned width) {
    EACH(i, count) {
        unsigned image = i / width / (tokens - 1);
        store(by_x, i, load(g, i + image * width));
    }
}

// Adds the gradients of the last tokens of all images.
KERNEL append_last(float *sum, const real *g, unsigned images, unsigned tokens, unsigned width) {
    EACH(channel, width) {
        float total = 0.0f;
        for (unsigned image = 0; image < images; image++)
            total += load(g, ((image + 1) * tokens - 1) * width + channel);
        sum[channel] += total;
    }
}

// Pairs each token but the last of its image with the last. y has `count` numbers; x has `tokens` tokens an image.
KERNEL with_last(real *y, const real *x, unsigned count, unsigned tokens, unsigned width) {
    EACH(i, count) {
        unsigned part = i / width % 2, pair = i / width / 2, channel = i % width;
        unsigned image = pair / (tokens - 1), token = part ? tokens - 1 : pair % (tokens - 1);
        store(y, i, load(x, (image * tokens + token) * width + channel));
    }
}

KERNEL with_last_back(real *by_x, const real *g, unsigned count, unsigned tokens, unsigned width) {
    EACH(i, count) {
        unsigned token = i / width % tokens, image = i / width / tokens, channel = i % width;
        const unsigned first = image * (tokens - 1) * 2 * width;
        float sum = 0.0f;
        if (token + 1 < tokens)
            sum = load(g, first + token * 2 * width + channel);
        else
            for (unsigned t = 0; t + 1 < tokens; t++)
                sum += load(g, first + (2 * t + 1) * width + channel);
        store(by_x, i, sum);
    }
}

// Takes tokens of every image by their indices; a negative index stands for zeros.
KERNEL gather(real *y, const real *x, const int *indices, unsigned count, unsigned to, unsigned from, unsigned width) {
    EACH(i, count) {
        unsigned image = i / width / to, channel = i % width;
        int token = indices[i / width % to];
        store(y, i, token < 0 ? 0.0f : load(x, (image * from + token) * width + channel));
    }
}

// Index in the coarse map [images, rows, columns, factor * factor * channels] of a number of the fine map.
static __device__ __forceinline__ unsigned coarse(
    unsigned i, unsigned rows, unsigned columns, unsigned channels, unsigned factor
) {
    unsigned channel = i % channels, pixel = i / channels;
    unsigned x = pixel % (columns * factor), y = pixel / (columns * factor);
    unsigned place = y % factor * factor + x % factor;
    unsigned of_coarse = y / factor * columns + x / factor;
    return (of_coarse * factor * factor + place) * channels + channel;
}

KERNEL depth_to_space(
    real *y, const real *x, unsigned count, unsigned rows, unsigned columns, unsigned channels, unsigned factor
) {
    EACH(i, count) y[i] = x[coarse(i, rows, columns, channels, factor)];
}

KERNEL depth_to_space_back(
    real *by_x, const real *g, unsigned count, unsigned rows, unsigned columns, unsigned channels, unsigned factor
) {
    EACH(i, count) by_x[coarse(i, rows, columns, channels, factor)] = g[i];
}

KERNEL pair(real *y, const real *a, const real *b, unsigned count) {
    EACH(i, count) {
        y[2 * i] = a[i];
        y[2 * i + 1] = b[i];
    }
}

KERNEL pair_back(real *by_a, real *by_b, const real *g, unsigned count) {
    EACH(i, count) {
        by_a[i] = g[2 * i];
        by_b[i] = g[2 * i + 1];
    }
}

// Levels of 0 to 255 as numbers from -1 to 1.
KERNEL from_levels(real *y, const unsigned char *levels, unsigned count) {
    EACH(i, count) store(y, i, levels[i] / 127.5f - 1.0f);
}

// Squares of a map [images, rows, columns, channels], pixel by pixel: [images, rows / side, columns / side, side * side * channels].
KERNEL space_to_depth(
    real *y, const real *x, unsigned count, unsigned rows, unsigned columns, unsigned channels, unsigned side
) {
    EACH(i, count) {
        unsigned channel = i % channels, place = i / channels % (side * side), patch = i / channels / (side * side);
        unsigned across = columns / side, down = rows / side;
        unsigned column = patch % across * side + place % side;
        unsigned row = patch / across % down * side + place / side;
        unsigned image = patch / across / down;
        y[i] = x[((image * rows + row) * columns + column) * channels + channel];
    }
}

// Adds the coordinates of the pixels, from -1 to 1, to a map of three channels.
KERNEL with_coordinates(real *y, const real *x, unsigned count, unsigned rows, unsigned columns) {
    EACH(i, count) {
        unsigned channel = i % 5, pixel = i / 5;
        if (channel < 3)
            y[i] = x[pixel * 3 + channel];
        else if (channel == 3)
            store(y, i, 2.0f * (pixel % columns + 0.5f) / columns - 1.0f);
        else
            store(y, i, 2.0f * (pixel / columns % rows + 0.5f) / rows - 1.0f);
    }
}

// Two neighbours of a place on an axis and the share of the second; see `Resample`.
struct Tap {
    unsigned low, high;
    float share;
};

static __device__ __forceinline__ Tap tap(unsigned i, unsigned from, unsigned to, int aligned) {
    float last = (float)(from - 1);
    // The quotients do not depend on i: loops compute them once.
    float at = aligned ? i * (last / (float)(to > 1 ? to - 1 : 1))
                       : fminf(fmaxf((i + 0.5f) * ((float)from / to) - 0.5f, 0.0f), last);
    Tap tap;
    tap.low = (unsigned)at < from - 1 ? (unsigned)at : from - 1;
    tap.high = tap.low + 1 < from ? tap.low + 1 : from - 1;
    tap.share = at - tap.low;
    return tap;
}

// V neighbouring numbers.
template <int V>
struct Some {
    float x[V];
};
static __device__ __forceinline__ void get(const real *p, unsigned i, Some<1> *to) {
    to->x[0] = load(p, i);
}
static __device__ __forceinline__ void get(const real *p, unsigned i, Some<4> *to) {
    Four four = load4(p, i);
    #pragma unroll
    for (int k = 0; k < 4; k++)
        to->x[k] = four.x[k];
}
static __device__ __forceinline__ void put(real *p, unsigned i, Some<1> from) {
    store(p, i, from.x[0]);
}
static __device__ __forceinline__ void put(real *p, unsigned i, Some<4> from) {
    Four four;
    #pragma unroll
    for (int k = 0; k < 4; k++)
        four.x[k] = from.x[k];
    store4(p, i, four);
}

template <int V>
static __device__ __forceinline__ void resample_some(
    real *__restrict__ y, const real *__restrict__ x, unsigned count, unsigned rows, unsigned columns, unsigned to_rows,
    unsigned to_columns, unsigned channels, int aligned
) {
    EACH(some, count / V) {
        unsigned i = some * V, channel = i % channels, pixel = i / channels;
        Tap across = tap(pixel % to_columns, columns, to_columns, aligned);
        Tap down = tap(pixel / to_columns % to_rows, rows, to_rows, aligned);
        const real *image = x + (size_t)(pixel / to_columns / to_rows) * rows * columns * channels + channel;
        Some<V> corners[4], result;
        get(image, (down.low * columns + across.low) * channels, &corners[0]);
        get(image, (down.low * columns + across.high) * channels, &corners[1]);
        get(image, (down.high * columns + across.low) * channels, &corners[2]);
        get(image, (down.high * columns + across.high) * channels, &corners[3]);
        #pragma unroll
        for (int k = 0; k < V; k++) {
            float above = corners[0].x[k] * (1.0f - across.share) + corners[1].x[k] * across.share;
            float below = corners[2].x[k] * (1.0f - across.share) + corners[3].x[k] * across.share;
            result.x[k] = above * (1.0f - down.share) + below * down.share;
        }
        put(y, i, result);
    }
}

// Resamples [images, rows, columns, channels] to [images, to_rows, to_columns, channels], which has `count` numbers.
KERNEL resample(
    real *__restrict__ y, const real *__restrict__ x, unsigned count, unsigned rows, unsigned columns, unsigned to_rows,
    unsigned to_columns, unsigned channels, int aligned
) {
    if (channels % 4)
        resample_some<1>(y, x, count, rows, columns, to_rows, to_columns, channels, aligned);
    else
        resample_some<4>(y, x, count, rows, columns, to_rows, to_columns, channels, aligned);
}

// Share of input `place` in the output i of an axis.
static __device__ __forceinline__ float share_of(unsigned place, unsigned i, unsigned from, unsigned to, int aligned) {
    Tap t = tap(i, from, to, aligned);
    return (t.low == place ? 1.0f - t.share : 0.0f) + (t.high == place ? t.share : 0.0f);
}

// First output of an axis that an input can reach, and the one behind the last.
static __device__ __forceinline__ void reach(
    unsigned place, unsigned from, unsigned to, int aligned, unsigned *first, unsigned *end
) {
    float step = aligned ? (from > 1 ? (float)(to > 1 ? to - 1 : 1) / (from - 1) : (float)to) : (float)to / from;
    float low = aligned ? (place - 1.0f) * step : (place - 0.5f) * step - 0.5f;
    float high = aligned ? (place + 1.0f) * step : (place + 1.5f) * step - 0.5f;
    // Edges are clamped, so that the first and the last input reach all that lies beyond them. Half a pixel more for rounding.
    *first = place == 0 || low < 1.0f ? 0 : (unsigned)(low - 0.5f);
    *end = place + 1 == from || high + 1.5f > to ? to : (unsigned)(high + 1.5f);
}

template <int V>
static __device__ __forceinline__ void resample_back_some(
    real *__restrict__ by_x, const real *__restrict__ g, unsigned count, unsigned rows, unsigned columns,
    unsigned to_rows, unsigned to_columns, unsigned channels, int aligned
) {
    EACH(some, count / V) {
        unsigned i = some * V, channel = i % channels, pixel = i / channels;
        unsigned column = pixel % columns, row = pixel / columns % rows;
        const real *image = g + (size_t)(pixel / columns / rows) * to_rows * to_columns * channels + channel;
        unsigned top, bottom, left, right;
        reach(row, rows, to_rows, aligned, &top, &bottom);
        reach(column, columns, to_columns, aligned, &left, &right);
        Some<V> sum = {};
        for (unsigned u = top; u < bottom; u++) {
            float down = share_of(row, u, rows, to_rows, aligned);
            if (down == 0.0f)
                continue;
            for (unsigned v = left; v < right; v++) {
                float share = down * share_of(column, v, columns, to_columns, aligned);
                if (share == 0.0f)
                    continue;
                Some<V> slope;
                get(image, (u * to_columns + v) * channels, &slope);
                #pragma unroll
                for (int k = 0; k < V; k++)
                    sum.x[k] += share * slope.x[k];
            }
        }
        put(by_x, i, sum);
    }
}

KERNEL resample_back(
    real *__restrict__ by_x, const real *__restrict__ g, unsigned count, unsigned rows, unsigned columns,
    unsigned to_rows, unsigned to_columns, unsigned channels, int aligned
) {
    if (channels % 4)
        resample_back_some<1>(by_x, g, count, rows, columns, to_rows, to_columns, channels, aligned);
    else
        resample_back_some<4>(by_x, g, count, rows, columns, to_rows, to_columns, channels, aligned);
}
