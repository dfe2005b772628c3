// 3 x 3 convolutions as products with copied windows, for machines without cuDNN; and depthwise convolutions.

// Copies the windows of a map [images, rows, columns, channels] to [images, out_rows, out_columns, 9, channels], zeros beyond the map.
// y has `count` numbers.
KERNEL windows(
    real *y, const real *x, unsigned count, unsigned rows, unsigned columns, unsigned channels, unsigned out_rows,
    unsigned out_columns, unsigned stride
) {
    EACH(i, count) {
        unsigned channel = i % channels, place = i / channels % 9, pixel = i / channels / 9;
        int column = (int)(pixel % out_columns * stride + place % 3) - 1;
        int row = (int)(pixel / out_columns % out_rows * stride + place / 3) - 1;
        unsigned image = pixel / out_columns / out_rows;
        bool inside = row >= 0 && column >= 0 && row < (int)rows && column < (int)columns;
        store(y, i, inside ? load(x, ((image * rows + row) * columns + column) * channels + channel) : 0.0f);
    }
}

// Adds the gradients by windows up to those by the map, which has `count` numbers.
KERNEL windows_back(
    real *by_x, const real *g, unsigned count, unsigned rows, unsigned columns, unsigned channels, unsigned out_rows,
    unsigned out_columns, unsigned stride
) {
    EACH(i, count) {
        unsigned channel = i % channels, pixel = i / channels;
        unsigned column = pixel % columns, row = pixel / columns % rows, image = pixel / columns / rows;
        float sum = 0.0f;
        for (unsigned place = 0; place < 9; place++) {
            // The window whose number at `place` lies on this pixel.
            int down = (int)(row + 1) - (int)(place / 3), across = (int)(column + 1) - (int)(place % 3);
            if (down < 0 || across < 0 || down % (int)stride || across % (int)stride)
                continue;
            unsigned u = down / stride, v = across / stride;
            if (u < out_rows && v < out_columns)
                sum += load(g, (((image * out_rows + u) * out_columns + v) * 9 + place) * channels + channel);
        }
        store(by_x, i, sum);
    }
}

// Depthwise convolution of a map with windows [channels, side, side]; `bias` may be null. With `turned`, the windows are turned by 180
// degrees, which gives the gradient by the map from that by the result.
KERNEL depthwise(
    real *y, const real *x, const float *weight, const float *bias, unsigned count, unsigned rows, unsigned columns,
    unsigned channels, unsigned side, int turned
) {
    EACH(i, count) {
        unsigned channel = i % channels, pixel = i / channels;
        int column = (int)(pixel % columns) - (int)side / 2, row = (int)(pixel / columns % rows) - (int)side / 2;
        const real *image = x + (size_t)(pixel / columns / rows) * rows * columns * channels + channel;
        const float *window = weight + channel * side * side;
        float sum = bias ? bias[channel] : 0.0f;
        for (unsigned u = 0; u < side; u++)
            for (unsigned v = 0; v < side; v++) {
                int r = row + (int)u, c = column + (int)v;
                if (r < 0 || c < 0 || r >= (int)rows || c >= (int)columns)
                    continue;
                unsigned place = turned ? side * side - 1 - (u * side + v) : u * side + v;
                sum += load(image, (r * columns + c) * channels) * window[place];
            }
        store(y, i, sum);
    }
}

// Parts of the gradient by the windows of a depthwise convolution: [blocks, channels, side * side]. Block y sums `per_block` rows of all
// images; threads are numbers of the windows, channels fastest.
KERNEL depthwise_parts(
    float *parts, const real *x, const real *g, unsigned rows, unsigned columns, unsigned channels, unsigned side,
    unsigned image_rows, unsigned per_block
) {
    unsigned k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= channels * side * side)
        return;
    unsigned channel = k % channels, place = k / channels;
    int down = (int)(place / side) - (int)side / 2, across = (int)(place % side) - (int)side / 2;
    unsigned first = blockIdx.y * per_block;
    unsigned end = first + per_block < image_rows ? first + per_block : image_rows;
    float sum = 0.0f;
    for (unsigned line = first; line < end; line++) {
        int row = (int)(line % rows) + down;
        if (row < 0 || row >= (int)rows)
            continue;
        unsigned of_x = line + down;
        for (unsigned column = 0; column < columns; column++) {
            int c = (int)column + across;
            if (c >= 0 && c < (int)columns)
                sum += load(x, (of_x * columns + c) * channels + channel)
                    * load(g, (line * columns + column) * channels + channel);
        }
    }
    parts[(blockIdx.y * channels + channel) * side * side + place] = sum;
}
