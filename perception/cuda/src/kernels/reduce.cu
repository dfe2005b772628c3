// Sums over rows, layer norm, loss and softmax. Sums have a fixed order, so that results do not change from run to run.

// Sums blocks of rows of a matrix [rows, width]: part [blocks, width], block k from row k * per_block on. Threads are columns.
KERNEL column_parts(float *parts, const real *x, unsigned rows, unsigned width, unsigned per_block) {
    unsigned column = blockIdx.x * blockDim.x + threadIdx.x;
    unsigned first = blockIdx.y * per_block;
    unsigned end = first + per_block < rows ? first + per_block : rows;
    if (column >= width)
        return;
    float sum = 0.0f;
    for (unsigned row = first; row < end; row++)
        sum += load(x, row * width + column);
    parts[blockIdx.y * width + column] = sum;
}

// Adds parts to a sum of floats; a part starts `step` numbers after the one before. A warp per number of the sum.
KERNEL add_parts(float *sum, const float *parts, unsigned count, unsigned width, unsigned step) {
    unsigned column = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (column >= width)
        return;
    float total = 0.0f;
    for (unsigned k = lane; k < count; k += 32)
        total += parts[k * step + column];
    total = warp_sum(total);
    if (lane == 0)
        sum[column] += total;
}

// Sums parts into `real` numbers: the gradient of a table that is computed.
KERNEL sum_parts(real *sum, const float *parts, unsigned count, unsigned width) {
    EACH(column, width) {
        float total = 0.0f;
        for (unsigned k = 0; k < count; k++)
            total += parts[k * width + column];
        store(sum, column, total);
    }
}

// Layer norm; a warp per row. `moments` receives mean and reciprocal deviation of each row if it is not null.
KERNEL layer_norm(
    real *y, float *moments, const real *x, const float *weight, const float *bias, unsigned rows, unsigned width,
    float eps
) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows)
        return;
    x += (size_t)row * width;
    y += (size_t)row * width;
    float sum = 0.0f;
    for (unsigned i = lane; i < width; i += 32)
        sum += load(x, i);
    float mean = warp_sum(sum) / width;
    float squares = 0.0f;
    for (unsigned i = lane; i < width; i += 32) {
        float d = load(x, i) - mean;
        squares += d * d;
    }
    float factor = 1.0f / sqrtf(warp_sum(squares) / width + eps);
    for (unsigned i = lane; i < width; i += 32)
        store(y, i, (load(x, i) - mean) * factor * weight[i] + bias[i]);
    if (moments && lane == 0) {
        moments[2 * row] = mean;
        moments[2 * row + 1] = factor;
    }
}

// Gradient by the input of a layer norm; a warp per row.
KERNEL layer_norm_back(
    real *by_x, const float *moments, const real *x, const float *weight, const real *g, unsigned rows, unsigned width
) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows)
        return;
    x += (size_t)row * width;
    g += (size_t)row * width;
    by_x += (size_t)row * width;
    float mean = moments[2 * row], factor = moments[2 * row + 1];
    float sum = 0.0f, along = 0.0f;
    for (unsigned i = lane; i < width; i += 32) {
        float by_unit = load(g, i) * weight[i];
        sum += by_unit;
        along += by_unit * (load(x, i) - mean) * factor;
    }
    sum = warp_sum(sum) / width;
    along = warp_sum(along) / width;
    for (unsigned i = lane; i < width; i += 32) {
        float unit = (load(x, i) - mean) * factor;
        store(by_x, i, factor * (load(g, i) * weight[i] - sum - unit * along));
    }
}

// Parts of the gradients by weight and bias of a layer norm: [blocks, 2, width]. Threads are columns.
KERNEL layer_norm_parts(
    float *parts, const float *moments, const real *x, const real *g, unsigned rows, unsigned width, unsigned per_block
) {
    unsigned column = blockIdx.x * blockDim.x + threadIdx.x;
    unsigned first = blockIdx.y * per_block;
    unsigned end = first + per_block < rows ? first + per_block : rows;
    if (column >= width)
        return;
    float by_weight = 0.0f, by_bias = 0.0f;
    for (unsigned row = first; row < end; row++) {
        float slope = load(g, row * width + column);
        by_weight += slope * (load(x, row * width + column) - moments[2 * row]) * moments[2 * row + 1];
        by_bias += slope;
    }
    parts[blockIdx.y * 2 * width + column] = by_weight;
    parts[(blockIdx.y * 2 + 1) * width + column] = by_bias;
}

// Parts of the gradient by the factors of `scale`: [blocks, width]. Threads are columns.
KERNEL scale_parts(float *parts, const real *x, const real *g, unsigned rows, unsigned width, unsigned per_block) {
    unsigned column = blockIdx.x * blockDim.x + threadIdx.x;
    unsigned first = blockIdx.y * per_block;
    unsigned end = first + per_block < rows ? first + per_block : rows;
    if (column >= width)
        return;
    float sum = 0.0f;
    for (unsigned row = first; row < end; row++)
        sum += load(x, row * width + column) * load(g, row * width + column);
    parts[blockIdx.y * width + column] = sum;
}

// Softmax of the rows of scores [rows, tokens], times `factor`, in place; a row starts `pitch` numbers after the one before. A warp per row.
KERNEL softmax(real *scores, unsigned rows, unsigned tokens, unsigned pitch, float factor) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows)
        return;
    scores += (size_t)row * pitch;
    float most = -1e30f;
    for (unsigned i = lane; i < tokens; i += 32)
        most = fmaxf(most, load(scores, i));
    most = warp_max(most);
    float sum = 0.0f;
    for (unsigned i = lane; i < tokens; i += 32)
        sum += expf((load(scores, i) - most) * factor);
    sum = warp_sum(sum);
    for (unsigned i = lane; i < tokens; i += 32)
        store(scores, i, expf((load(scores, i) - most) * factor) / sum);
}

// The same in windows: adds to each score the number of its relative position and head from `table` [positions, heads], and keeps
// tokens of other regions apart. Rows are [windows, heads, tokens]; `regions` are those of the windows of an image.
KERNEL window_softmax(
    real *scores, const float *table, const int *regions, unsigned rows, unsigned pitch, unsigned heads,
    unsigned side, unsigned windows, float factor
) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows)
        return;
    unsigned tokens = side * side, query = row % tokens, head = row / tokens % heads;
    const int *region = regions + row / tokens / heads % windows * tokens;
    scores += (size_t)row * pitch;
    float most = -1e30f;
    for (unsigned i = lane; i < tokens; i += 32) {
        unsigned down = query / side + side - 1 - i / side, across = query % side + side - 1 - i % side;
        float bias = table[(down * (2 * side - 1) + across) * heads + head];
        float score = region[i] == region[query] ? load(scores, i) * factor + bias : -1e30f;
        store(scores, i, score);
        most = fmaxf(most, score);
    }
    most = warp_max(most);
    float sum = 0.0f;
    for (unsigned i = lane; i < tokens; i += 32)
        sum += expf(load(scores, i) - most);
    sum = warp_sum(sum);
    for (unsigned i = lane; i < tokens; i += 32)
        store(scores, i, expf(load(scores, i) - most) / sum);
}

// Gradient by the scores, times `factor`, from that by the shares, in place; a warp per row.
KERNEL softmax_back(
    real *by_shares, const real *shares, unsigned rows, unsigned tokens, unsigned pitch, float factor
) {
    unsigned row = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    if (row >= rows)
        return;
    by_shares += (size_t)row * pitch;
    shares += (size_t)row * pitch;
    float mean = 0.0f;
    for (unsigned i = lane; i < tokens; i += 32)
        mean += load(by_shares, i) * load(shares, i);
    mean = warp_sum(mean);
    for (unsigned i = lane; i < tokens; i += 32)
        store(by_shares, i, load(shares, i) * (load(by_shares, i) - mean) * factor);
}

// Adds to the gradient by the table of relative positions that of the scores [windows, heads, tokens, pitch] divided by `factor`.
// A warp per number of the table.
KERNEL table_back(
    float *by_table, const real *by_scores, unsigned windows, unsigned pitch, unsigned heads, unsigned side, float factor
) {
    unsigned place = (blockIdx.x * blockDim.x + threadIdx.x) / 32, lane = threadIdx.x % 32;
    unsigned across = 2 * side - 1, tokens = side * side;
    if (place >= across * across * heads)
        return;
    unsigned head = place % heads;
    int down = (int)(place / heads / across) - (int)side + 1, right = (int)(place / heads % across) - (int)side + 1;
    float sum = 0.0f;
    for (unsigned k = lane; k < windows * tokens; k += 32) {
        unsigned window = k / tokens, query = k % tokens;
        int row = (int)(query / side) - down, column = (int)(query % side) - right;
        if (row < 0 || column < 0 || row >= (int)side || column >= (int)side)
            continue;
        sum += load(by_scores, ((window * heads + head) * tokens + query) * pitch + row * side + column);
    }
    sum = warp_sum(sum);
    if (lane == 0)
        by_table[place] += sum / factor;
}

// Moves queries, keys and values [images, tokens, parts, heads, size] to [parts, images, heads, tokens, size].
KERNEL split_heads(
    real *y, const real *x, unsigned count, unsigned images, unsigned tokens, unsigned parts, unsigned heads,
    unsigned size
) {
    EACH(i, count) {
        unsigned d = i % size, rest = i / size;
        unsigned token = rest % tokens, head = rest / tokens % heads, image = rest / tokens / heads % images;
        unsigned part = rest / tokens / heads / images;
        y[i] = x[(((image * tokens + token) * parts + part) * heads + head) * size + d];
    }
}

// The reverse of `split_heads`.
KERNEL join_heads(
    real *y, const real *x, unsigned count, unsigned images, unsigned tokens, unsigned parts, unsigned heads,
    unsigned size
) {
    EACH(i, count) {
        unsigned d = i % size, rest = i / size;
        unsigned head = rest % heads, part = rest / heads % parts;
        unsigned token = rest / heads / parts % tokens, image = rest / heads / parts / tokens;
        y[i] = x[(((part * images + image) * heads + head) * tokens + token) * size + d];
    }
}

// Loss of `count` pixels and its slopes by the output [count, 2]; the mean is over `pixels` pixels. Parts of the sum, one per block of
// 256 threads. Penalties: 0 square, 1 size, 2 Huber.
KERNEL touch_loss(
    float *parts, real *slopes, const real *output, const float *indentation_mm, const float *contact, unsigned count,
    float pixels, int penalty, float huber_mm, float contact_weight, float segmentation
) {
    float sum = 0.0f;
    EACH(i, count) {
        float error = load(output, 2 * i) - indentation_mm[i], logit = load(output, 2 * i + 1), share = contact[i];
        float weight = 1.0f + (contact_weight - 1.0f) * share;
        float size = fabsf(error), sign = error > 0.0f ? 1.0f : error < 0.0f ? -1.0f : 0.0f;
        float cost = size, slope = sign;
        if (penalty == 0) {
            cost = error * error;
            slope = 2.0f * error;
        } else if (penalty == 2) {
            cost = size < huber_mm ? 0.5f * error * error / huber_mm : size - 0.5f * huber_mm;
            slope = size < huber_mm ? error / huber_mm : sign;
        }
        sum += weight * cost + segmentation * (softplus(logit) - logit * share);
        store(slopes, 2 * i, weight * slope / pixels);
        store(slopes, 2 * i + 1, segmentation * (sigmoid(logit) - share) / pixels);
    }
    sum = block_sum(sum);
    if (threadIdx.x == 0)
        parts[blockIdx.x] = sum / pixels;
}
