!> The first step of a motion with memory that does not start at rest.
!!
!! A weakly singular kernel makes accelerations grow like t^alpha after a deflection
!! or a push at t = 0, which no polynomial follows. The step is made of panels that
!! double their length, [0, d], [d, 2d], [2d, 4d] ... [h/2, h]: on each of them the
!! motion is smooth, and the error of the first is negligible. The past of a panel consists of the
!! previous panel, with exact weights, and of point masses at Chebyshev points for the
!! earlier past, which are transferred from each interval to the next, twice as long.
module viscovib_hereditary_start
  use viscovib_known_past, only: known_past_type
  use viscovib_memory_channels, only: channels_type
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_constants, only: pi
  use viscovib_counters, only: count_up, counted_panels, counting
  use viscovib_dense, only: factorize, solve
  use viscovib_hereditary_maps, only: local_weights
  use viscovib_history, only: far_nodes, past_type
  use viscovib_gauss_points, only: points_16, weights_16
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_quadrature, only: lagrange, lagrange_factors
  use viscovib_step_equations, only: out_of_reach
  use viscovib_stopping, only: given_up
  use viscovib_time_load, only: time_load_type
  implicit none
  private

  public :: direct_panels, march_start, panel_ends, panel_maker, start_type

  !> Doublings from the first panel to the step: the first panel causes an error of
  !! a velocity below (2^-doublings)^(1+alpha) of its change over the step.
  integer, parameter :: doublings = 44
  integer, parameter :: max_iterations = 100
  !> Smallest number of nodes of a panel; no step has as many.
  integer, parameter :: least_nodes = 9

  type :: start_type
    type(collocation_type) :: table
    !> The past that subsequent steps need.
    type(past_type) :: past
    !> Ends of the panels, shape (0:n).
    real(wp), allocatable :: ends(:)
    !> Displacements at the start of each panel, shape (n_dof, n), and displacements relative to it
    !! at its other points, shape (s+1, n_dof, n). On a panel of 1e-13 of a step the displacements
    !! themselves are equal to rounding, and give no velocity.
    real(wp), allocatable :: begins(:, :), rises(:, :, :)
  contains
    procedure :: at
  end type start_type

  !> Solves panels, one after the other, and stores the state at the end of the last.
  type, abstract :: panel_maker
  contains
    procedure(make_interface), deferred :: make
  end type panel_maker

  !> Panels of a system whose equations of motion are solved for the accelerations.
  type, extends(panel_maker) :: direct_panels
    !> State, shape (n_dof).
    real(wp), allocatable :: u(:), v(:)
    !> The solved panels, as in `start_type`.
    integer :: n_made = 0
    real(wp), allocatable :: begins(:, :), rises(:, :, :)
  contains
    procedure :: make => make_panel
  end type direct_panels

  abstract interface

    !> Solve the next panel, from time `now`. `made` is false if the iteration does not converge.
    subroutine make_interface(self, system, channels, load, table, local, now, length, &
                              remembered, points, g, made)
      import :: channels_type, collocation_type, oscillator_type, panel_maker, time_load_type, wp
      class(panel_maker), intent(inout) :: self
      class(oscillator_type), intent(in) :: system
      type(channels_type), intent(in) :: channels
      type(time_load_type), intent(in) :: load
      type(collocation_type), intent(in) :: table
      !> L of each kernel.
      real(wp), intent(in) :: local(table%s, 0:table%s + 1, size(system%kernels))
      real(wp), intent(in) :: now, length
      !> Memory at the nodes, shape (s, n_channels).
      real(wp), intent(in) :: remembered(:, :)
      !> Displacements and channels at the points, shapes (0:s+1, n_dof), (0:s+1, n_channels).
      real(wp), intent(out) :: points(0:table%s + 1, size(system%gather, 2)), g(0:, :)
      logical, intent(out) :: made
    end subroutine make_interface

  end interface

contains

  !> March over [0, h]. `made` is false if a plain step suffices, or if a panel does not converge
  !! because the step is too large.
  subroutine march_start(start, system, channels, load, known_past, h, panels, made)
    type(start_type), intent(out) :: start
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(time_load_type), intent(in) :: load
    !> The motion before.
    type(known_past_type), intent(in) :: known_past
    real(wp), intent(in) :: h
    !> With the state at 0 on entry, and at h on return.
    class(panel_maker), intent(inout) :: panels
    logical, intent(out) :: made
    real(wp) :: length
    real(wp), allocatable :: g(:, :), before(:, :), points(:, :), remembered(:, :)
    real(wp), allocatable :: local(:, :, :, :), of_kernel(:, :, :)
    real(wp) :: masses(far_nodes, size(channels%kernel_of)), x(far_nodes), factors(far_nodes)
    real(wp) :: of_old(size(channels%kernel_of))
    integer :: k, m, nodes

    made = .false.
    if (.not. known_past%is_known() .and. is_smooth(system, channels, h)) return
    nodes = nodes_of(h)
    allocate (g(0:nodes + 1, size(channels%kernel_of)), points(0:nodes + 1, system%n_dof()))
    allocate (before, mold=g)
    allocate (remembered(nodes, size(channels%kernel_of)))
    allocate (local(nodes, 0:nodes + 1, size(system%kernels), doublings + 1))
    allocate (of_kernel(nodes, 0:nodes + 1, doublings + 1))
    x = [(0.5_wp - 0.5_wp*cos((m - 0.5_wp)*pi/far_nodes), m=1, far_nodes)]
    factors = lagrange_factors(x)
    call new_collocation(start%table, nodes)
    allocate (start%ends(0:doublings + 1))
    start%ends(0) = 0.0_wp
    do k = 1, doublings + 1
      start%ends(k) = scale(h, k - 1 - doublings)
    end do
    local = 0.0_wp
    do k = 1, size(system%kernels)
      if (.not. any(channels%kernel_of == k)) cycle
      call local_weights(system%kernels(k), start%table, &
                         start%ends(1:) - start%ends(:doublings), of_kernel)
      local(:, :, k, :) = of_kernel
    end do
    masses = 0.0_wp
    before = 0.0_wp
    do k = 1, doublings + 1
      made = .not. given_up()
      if (.not. made) return
      length = start%ends(k) - start%ends(k - 1)
      if (counting) call count_up(counted_panels, 1)
      remembered = 0.0_wp
      if (k > 1) call recall(system, channels, start%table, start%ends(k - 1), length, &
                             start%ends(k - 2), before, x, masses, k > 2, remembered)
      if (known_past%is_known()) then
        do m = 1, nodes
          call known_past%recall(system%kernels, channels%kernel_of, &
                              start%ends(k - 1) + start%table%points(m)*length, of_old)
          remembered(m, :) = remembered(m, :) + of_old
        end do
      end if
      call panels%make(system, channels, load, start%table, local(:, :, :, k), &
                       start%ends(k - 1), length, remembered, points, g, made)
      if (.not. made) return
      if (k > 1) call carry(start%table, k == 2, start%ends(k - 1) - start%ends(k - 2), before, x, &
                            factors, masses)
      before = g
    end do
    start%past%times = start%ends(doublings)*x
    start%past%masses = masses
    start%past%length = length
    start%past%last = g
  end subroutine march_start

  !> True if the kernels, and thus the motion, are smooth over the first step. Knots of a table and
  !! the jump at its end come later: there point masses would reduce the order of the steps.
  pure logical function is_smooth(system, channels, h)
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    real(wp), intent(in) :: h
    integer :: k

    is_smooth = .true.
    do k = 1, size(system%kernels)
      if (any(channels%kernel_of == k)) then
        is_smooth = is_smooth .and. h <= system%kernels(k)%kernel%smooth_until
      end if
    end do
  end function is_smooth

  !> Nodes of the panels of a first step. A step half as long, and the step after it, use some of
  !! the intervals of the whole step: with other nodes, their errors differ.
  pure integer function nodes_of(h)
    real(wp), intent(in) :: h
    nodes_of = least_nodes + modulo(exponent(h), 2)
  end function nodes_of

  !> Memory at the nodes of a panel from `now` on: the panel before, and the earlier
  !! past as point masses on [0, since].
  subroutine recall(system, channels, table, now, length, since, before, x, masses, far, &
                    remembered)
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: now, length, since
    real(wp), intent(in) :: before(0:table%s + 1, size(channels%kernel_of))
    real(wp), intent(in) :: x(far_nodes), masses(far_nodes, size(channels%kernel_of))
    !> True if there is an earlier past.
    logical, intent(in) :: far
    real(wp), intent(out) :: remembered(table%s, size(channels%kernel_of))
    real(wp), allocatable :: sigma(:), w(:)
    real(wp) :: weights(0:table%s + 1), values(far_nodes), node, last
    integer :: c, i, j, k

    remembered = 0.0_wp
    last = now - since
    do k = 1, size(system%kernels)
      if (.not. any(channels%kernel_of == k)) cycle
      do i = 1, table%s
        node = table%points(i)*length
        call system%kernels(k)%lag_rule(node, node + last, sigma, w)
        weights = 0.0_wp
        do j = 1, size(sigma)
          weights = weights + w(j)*table%basis(1.0_wp - (sigma(j) - node)/last)
        end do
        if (far) call system%kernels(k)%value(now + node - since*x, values)
        do c = 1, size(channels%kernel_of)
          if (channels%kernel_of(c) /= k) cycle
          remembered(i, c) = dot_product(weights, before(:, c))
          if (far) remembered(i, c) = remembered(i, c) + dot_product(values, masses(:, c))
        end do
      end do
    end do
  end subroutine recall

  !> Add a panel to the earlier past: masses of the interval before, [0, 1/2] of the new
  !! interval, and of the panel, its other half (all of it for the first panel).
  subroutine carry(table, first, length, before, x, factors, masses)
    type(collocation_type), intent(in) :: table
    logical, intent(in) :: first
    real(wp), intent(in) :: length, x(far_nodes), factors(far_nodes)
    real(wp), intent(in) :: before(0:, :)
    real(wp), intent(inout) :: masses(:, :)
    real(wp) :: fresh(far_nodes, size(masses, 2))
    real(wp) :: share(far_nodes), mass(size(masses, 2))
    integer :: j, m

    fresh = 0.0_wp
    do j = 1, size(points_16)
      share = lagrange(x, factors, merge(points_16(j), 0.5_wp + 0.5_wp*points_16(j), first))
      mass = length*weights_16(j)*matmul(table%basis(points_16(j)), before)
      do m = 1, size(mass)
        fresh(:, m) = fresh(:, m) + share*mass(m)
      end do
    end do
    if (.not. first) then
      do j = 1, far_nodes
        share = lagrange(x, factors, 0.5_wp*x(j))
        do m = 1, size(mass)
          fresh(:, m) = fresh(:, m) + share*masses(j, m)
        end do
      end do
    end if
    masses = fresh
  end subroutine carry

  !> Solve a panel: accelerations at its nodes by fixed-point iteration, which contracts like the
  !! square of its length.
  subroutine make_panel(self, system, channels, load, table, local, now, length, remembered, &
                        points, g, made)
    class(direct_panels), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(channels_type), intent(in) :: channels
    type(time_load_type), intent(in) :: load
    type(collocation_type), intent(in) :: table
    real(wp), intent(in) :: local(table%s, 0:table%s + 1, size(system%kernels))
    real(wp), intent(in) :: now, length, remembered(:, :)
    real(wp), intent(out) :: points(0:table%s + 1, size(system%gather, 2)), g(0:, :)
    logical, intent(out) :: made
    real(wp), dimension(table%s, size(self%u)) :: a, new, f, speed, force
    real(wp) :: rise(table%s + 1, size(self%u))
    real(wp) :: mass(size(self%u), size(self%u)), inner(table%s, size(self%u))
    real(wp) :: w(0:table%s + 1, system%n_memory()), bend(table%s + 2, system%n_memory())
    real(wp) :: whole(table%s, size(channels%kernel_of)), kept(table%s, system%n_memory())
    real(wp) :: row(size(self%u)), change, before
    real(wp) :: seen(0:table%s + 1, size(self%u) + system%n_rates())
    integer :: pivots(size(self%u)), n, i, k, turn, s
    logical :: singular

    made = .false.
    points = 0.0_wp
    g = 0.0_wp
    mass = system%mass
    n = size(self%u)
    call factorize(n, mass, pivots, singular)
    if (singular) return
    s = table%s
    do i = 1, s
      call load%at(now + table%points(i)*length, row)
      f(i, :) = row
    end do
    a = 0.0_wp
    before = huge(1.0_wp)
    bend = 0.0_wp
    do turn = 1, max_iterations
      do k = 1, n
        rise(:, k) = length*(table%points(1:)*self%v(k) + length*matmul(table%a2, a(:, k)))
        points(0, k) = self%u(k)
        points(1:, k) = self%u(k) + rise(:, k)
        speed(:, k) = self%v(k) + length*matmul(table%a1, a(:, k))
      end do
      seen(:, :n) = points
      do k = 1, system%n_rates()
        associate (b => system%rates(k))
          seen(0, n + k) = self%v(b)
          seen(1:s, n + k) = speed(:, b)
          seen(s + 1, n + k) = self%v(b) + length*dot_product(table%b, a(:, b))
        end associate
      end do
      if (any(system%bent)) call system%deflection_remainder(seen, bend)
      w = matmul(points, transpose(system%gather))
      do k = 1, system%n_memory()
        if (system%bent(k)) w(:, k) = w(:, k) + bend(:, k)
      end do
      g = matmul(w, transpose(channels%gather))
      whole = remembered
      do k = 1, size(channels%kernel_of)
        g(:, k) = g(:, k) - channels%held(k)
        whole(:, k) = whole(:, k) + channels%held_recalled(k)
      end do
      do k = 1, size(channels%kernel_of)
        whole(:, k) = whole(:, k) + matmul(local(:, :, channels%kernel_of(k)), g(:, k))
      end do
      new = f - matmul(speed, transpose(system%damping)) &
            - matmul(w(1:s, :), transpose(system%spread)) &
            + matmul(whole, transpose(channels%spread))
      if (.not. system%separable) then
        kept = w(1:s, :) - matmul(whole, channels%gather)
        inner = points(1:s, :)
        if (system%moving) then
          call system%moving_remainder(inner, speed, kept, f, force)
        else
          call system%force_remainder(inner, kept, force)
        end if
        new = new - force
      end if
      do i = 1, s
        row = new(i, :)
        call solve(n, mass, pivots, row)
        new(i, :) = row
      end do
      change = maxval(abs(new - a))
      a = new
      if (.not. change <= out_of_reach) return
      made = change <= 4.0_wp*epsilon(1.0_wp)*maxval(abs(a)) &
             .or. (change >= 0.5_wp*before .and. change <= 1.0e-12_wp*maxval(abs(a)))
      if (made) exit
      before = change
    end do
    if (.not. made) return
    call keep_panel(self, rise)
    self%u = points(s + 1, :)
    self%v = self%v + length*matmul(table%b, a)
  end subroutine make_panel

  !> Store the start of a panel, and its other points relative to the start.
  subroutine keep_panel(panels, rise)
    class(direct_panels), intent(inout) :: panels
    real(wp), intent(in) :: rise(:, :)
    if (.not. allocated(panels%begins)) then
      allocate (panels%begins(size(rise, 2), doublings + 1))
      allocate (panels%rises(size(rise, 1), size(rise, 2), doublings + 1))
    end if
    panels%n_made = panels%n_made + 1
    panels%begins(:, panels%n_made) = panels%u
    panels%rises(:, :, panels%n_made) = rise
  end subroutine keep_panel

  !> State at a time within the step.
  subroutine at(self, t, u, v)
    class(start_type), intent(in) :: self
    real(wp), intent(in) :: t
    real(wp), intent(out) :: u(:), v(:)
    real(wp), dimension(size(self%table%points)) :: basis, slopes
    real(wp) :: length, theta
    integer :: k

    k = 1
    do while (k < size(self%rises, 3) .and. t > self%ends(k))
      k = k + 1
    end do
    length = self%ends(k) - self%ends(k - 1)
    theta = (t - self%ends(k - 1))/length
    basis = self%table%basis(theta)
    slopes = self%table%slopes(theta)
    u = self%begins(:, k) + matmul(basis(2:), self%rises(:, :, k))
    v = matmul(slopes(2:), self%rises(:, :, k))/length
  end subroutine at

  !> 0, then powers of 2 that double, then h. `between`: 3/4 of these powers.
  pure function panel_ends(h, doublings, between) result(ends)
    real(wp), intent(in) :: h
    integer, intent(in) :: doublings
    logical, intent(in) :: between
    real(wp) :: ends(0:doublings + 1)
    integer :: k
    ends(0) = 0.0_wp
    do k = 1, doublings
      ends(k) = scale(merge(0.75_wp, 1.0_wp, between), exponent(h) - 1 - doublings + k)
    end do
    ! The last power is at most 3 h/4.
    if (ends(doublings) > 0.75_wp*h) ends(1:doublings) = 0.5_wp*ends(1:doublings)
    ends(doublings + 1) = h
  end function panel_ends

end module viscovib_hereditary_start
