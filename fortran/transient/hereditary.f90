!> Motion with memory in equal steps: Gauss collocation of the accelerations, with
!! hereditary variables remembered as polynomials through the nodes and both ends.
!!
!! The equations of a step are in `hereditary_maps`; nonlinear parts are found by
!! iterating X = G z + Z y(X), which contracts like h^2 times the nonlinear
!! stiffness, and by Newton's method where that does not.
module viscovib_hereditary
  use viscovib_channels, only: channels_type, new_channels
  use viscovib_collocation, only: collocation_type, new_collocation
  use viscovib_dense, only: factorize, solve
  use viscovib_direct_history, only: direct_history_type, new_direct_history
  use viscovib_exponential_history, only: exponential_history_type, new_exponential_history
  use viscovib_hereditary_maps, only: new_step_map, row_block, step_map_type
  use viscovib_hereditary_start, only: march_start, start_type
  use viscovib_history, only: history_type
  use viscovib_kinds, only: i8, wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_time_load, only: load_clock, new_clock, time_load_type
  implicit none
  private

  public :: hereditary_type, new_hereditary

  !> How the past is kept: as exponentials, or step by step.
  integer, parameter, public :: past_exponentials = 1, past_direct = 2
  !> Why no run can be made.
  integer, parameter, public :: begun = 0, no_exponentials = 1, step_too_large = 2, no_integral = 3

  integer, parameter :: max_iterations = 50
  !> Contraction beyond which Newton's method takes over, and turns before it is judged.
  real(wp), parameter :: slow = 0.25_wp
  integer, parameter :: patience = 2
  !> Change at which rounding is all that is left, relative to displacements.
  real(wp), parameter :: rounding = 1.0e-13_wp

  type :: hereditary_type
    real(wp) :: h = 0.0_wp
    !> State, shape (n_dof), and what rounding took from it.
    real(wp), allocatable :: u(:), v(:), u_rest(:), v_rest(:)
    integer :: n_iterations = 0
    type(collocation_type) :: table
    type(step_map_type) :: map
    type(channels_type) :: channels
    class(history_type), allocatable :: history
    type(load_clock) :: clock
    type(start_type) :: start
    !> Solution counts as found at this change, relative to displacements.
    real(wp) :: solved = rounding
    !> Displacements at the points of the last step, shape (0:s+1, n_dof).
    real(wp), allocatable :: points(:, :)
    !> Nonlinear part of the hereditary variables there, shape (0:s+1, n_bent), and
    !! force remainder at the nodes, shape (s, n_dof).
    real(wp), allocatable, private :: bends(:, :), remainders(:, :)
    !> What carries these on to the next step.
    real(wp), allocatable, private :: onward(:, :), onward_nodes(:, :)
    !> T W, shape (n_channels, n_dof), and T of the bent variables.
    real(wp), allocatable, private :: gather(:, :), gather_bends(:, :)
    !> The next step follows one of its own kind.
    logical, private :: rolling = .false.
  contains
    procedure :: step
    procedure :: inside
    procedure :: memory_size
    procedure :: save_memory
    procedure :: load_memory
    procedure, private :: iterate
    procedure, private :: evaluate_bends
    procedure, private :: newton_step
    procedure, private :: predict
    procedure, private :: add_first_step
  end type hereditary_type

contains

  !> A run from (u, v) at time 0. `reason`: `begun`, or why it is not.
  subroutine new_hereditary(run, system, load, s, past, held, u, v, h, t_end, tolerance, reason)
    type(hereditary_type), intent(out) :: run
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Nodes of a step; `past_exponentials` or `past_direct`.
    integer, intent(in) :: s, past
    !> Displacement held for all t < 0, shape (n_dof): what is remembered.
    real(wp), intent(in) :: held(:)
    !> Start, shape (n_dof); step; latest time; relative error of the kernels as
    !! exponentials and of a step's solution.
    real(wp), intent(in) :: u(:), v(:), h, t_end, tolerance
    integer, intent(out) :: reason
    type(exponential_history_type), allocatable :: exponentials
    type(direct_history_type), allocatable :: direct
    logical :: possible, singular
    integer :: j

    reason = begun
    run%h = h
    run%u = u
    run%v = v
    run%u_rest = 0.0_wp*u
    run%v_rest = 0.0_wp*v
    run%solved = max(1.0e-2_wp*tolerance, epsilon(1.0_wp))
    call new_collocation(run%table, s)
    if (any(abs(held) > 0.0_wp) .and. system%kernel_without_integral() > 0) then
      reason = no_integral
      return
    end if
    call new_channels(run%channels, system, held)
    call new_step_map(run%map, system, run%channels, run%table, h, singular)
    if (singular) then
      reason = step_too_large
      return
    end if
    if (past == past_exponentials) then
      allocate (exponentials)
      call new_exponential_history(exponentials, system, run%channels, run%table, h, t_end, &
                                   max(tolerance, 1.0e-14_wp), possible)
      if (.not. possible) then
        reason = no_exponentials
        return
      end if
      call move_alloc(exponentials, run%history)
    else
      allocate (direct)
      call new_direct_history(direct, system, run%channels, run%table, h)
      call move_alloc(direct, run%history)
    end if
    call new_clock(run%clock, load, 0.0_wp, h, run%table%points(1:s))
    run%gather = matmul(run%channels%gather, system%gather)
    run%gather_bends = run%channels%gather(:, run%map%bent)
    allocate (run%points(0:s + 1, size(u)), run%bends(0:s + 1, size(run%map%bent)))
    allocate (run%remainders(s, size(u)))
    run%points = 0.0_wp
    run%bends = 0.0_wp
    run%remainders = 0.0_wp
    allocate (run%onward(s + 1, 0:s + 1), run%onward_nodes(s, s))
    do j = 1, s + 1
      run%onward(j, :) = run%table%basis(1.0_wp + run%table%points(j))
    end do
    call node_extrapolation(run%table, run%onward_nodes)
    call start_bends(run, system)
  end subroutine new_hereditary

  !> From values at the nodes of one step to those at the nodes of the next.
  subroutine node_extrapolation(table, onward)
    use viscovib_quadrature, only: lagrange, lagrange_factors
    type(collocation_type), intent(in) :: table
    real(wp), intent(out) :: onward(:, :)
    real(wp) :: c(table%s), factors(table%s)
    integer :: i
    c = table%points(1:table%s)
    factors = lagrange_factors(c)
    do i = 1, table%s
      onward(i, :) = lagrange(c, factors, 1.0_wp + c(i))
    end do
  end subroutine node_extrapolation

  !> Nonlinear part at the present state, as the start of the next step.
  subroutine start_bends(self, system)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp) :: u(1, size(self%u)), w(1, system%n_memory())

    u(1, :) = self%u
    w = 0.0_wp
    if (size(self%map%bent) > 0) call system%deflection_remainder(u, w)
    self%bends(self%table%s + 1, :) = w(1, self%map%bent)
    self%points(self%table%s + 1, :) = self%u
    self%rolling = .false.
  end subroutine start_bends

  !> One step; `made` is false, and the state stays, if its equations do not settle.
  subroutine step(self, system, load, n_before, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    !> Steps made before.
    integer(i8), intent(in) :: n_before
    logical, intent(out) :: made
    real(wp) :: remembered(self%map%s, self%map%n_channels)
    real(wp) :: forces(self%map%s, self%map%n_dof), z(size(self%map%from_input, 2))
    real(wp) :: g(0:self%map%s + 1, self%map%n_channels), x(size(self%map%from_input, 1))
    integer :: c, d, n, s

    s = self%map%s
    n = self%map%n_dof
    if (n_before == 0) then
      call self%add_first_step(system, load, made)
      if (made) return
    end if
    call self%clock%at_nodes(load, forces)
    z(:n) = self%u
    z(n + 1:2*n) = self%v
    do d = 1, n
      z(self%map%at_load + (d - 1)*s + 1:self%map%at_load + d*s) = forces(:, d)
    end do
    if (self%map%n_channels > 0) call self%history%recall(remembered)
    do c = 1, self%map%n_channels
      z(self%map%at_memory + (c - 1)*s + 1:self%map%at_memory + c*s) = remembered(:, c) &
                                                                       + self%map%held(:, c)
    end do
    z(self%map%at_bend + 1:) = self%bends(s + 1, :)
    call self%predict()
    call self%iterate(system, z, x, made)
    if (.not. made) return
    self%points(0, :) = self%u
    do d = 1, n
      self%points(1:, d) = self%u(d) + x((d - 1)*(s + 1) + 1:d*(s + 1))
      call add_up(self%u(d), self%u_rest(d), x(d*(s + 1)))
      call add_up(self%v(d), self%v_rest(d), x(self%map%velocity_row + d - 1))
    end do
    do c = 1, self%map%n_channels
      g(:, c) = -self%channels%held(c)
      do d = 1, n
        g(:, c) = g(:, c) + self%gather(c, d)*self%points(:, d)
      end do
      do d = 1, size(self%map%bent)
        g(:, c) = g(:, c) + self%gather_bends(c, d)*self%bends(:, d)
      end do
    end do
    if (self%map%n_channels > 0) call self%history%store(g)
    call self%clock%advance((n_before + 1)*self%h)
    self%rolling = .true.
  end subroutine step

  !> The first step as a sequence of panels, where memory makes the start singular;
  !! `made` is false where a plain step will do.
  subroutine add_first_step(self, system, load, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    type(time_load_type), intent(in) :: load
    logical, intent(out) :: made
    real(wp) :: f(size(self%u))

    made = .false.
    if (self%map%n_channels == 0) return
    call load%at(0.0_wp, f)
    if (.not. (any(abs(self%u) > 0.0_wp) .or. any(abs(self%v) > 0.0_wp) &
               .or. any(abs(f) > 0.0_wp))) return
    call march_start(self%start, system, self%channels, load, self%h, self%u, self%v, made)
    if (.not. made) return
    call self%history%begin(self%start%table, self%start%past)
    call self%clock%advance(self%h)
    call start_bends(self, system)
  end subroutine add_first_step

  !> Compensated sum.
  elemental subroutine add_up(total, rest, increment)
    real(wp), intent(inout) :: total, rest
    real(wp), intent(in) :: increment
    real(wp) :: part, sum
    part = increment + rest
    sum = total + part
    rest = part - (sum - total)
    total = sum
  end subroutine add_up

  !> Nonlinear parts at the points of the next step by those of the last.
  subroutine predict(self)
    class(hereditary_type), intent(inout) :: self
    real(wp) :: ahead(self%table%s + 1), start
    integer :: b

    do b = 1, size(self%bends, 2)
      start = self%bends(self%table%s + 1, b)
      if (self%rolling) then
        ahead = matmul(self%onward, self%bends(:, b))
      else
        ahead = start
      end if
      self%bends(0, b) = start
      self%bends(1:, b) = ahead
    end do
    if (self%map%separable .or. .not. self%rolling) return
    do b = 1, size(self%remainders, 2)
      self%remainders(:, b) = matmul(self%onward_nodes, self%remainders(:, b))
    end do
  end subroutine predict

  !> X = G z + Z y(X), from the predicted y on.
  subroutine iterate(self, system, z, x, made)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: z(:)
    real(wp), intent(out) :: x(:)
    logical, intent(out) :: made
    real(wp), dimension(size(x)) :: linear, next
    real(wp) :: y(size(self%map%from_bend, 2)), change, before, size_of
    integer :: turn, n_u
    logical :: newton

    n_u = self%map%velocity_row - 1
    call product_of(size(x), size(z), self%map%from_input, z, linear)
    if (size(y) == 0) then
      x = linear
      made = all(abs(x) <= huge(1.0_wp))
      return
    end if
    call pack_bends(self, y)
    call product_of(size(x), size(y), self%map%from_bend, y, x)
    x = linear + x
    newton = .false.
    before = huge(1.0_wp)
    made = .false.
    do turn = 1, max_iterations
      self%n_iterations = self%n_iterations + 1
      call self%evaluate_bends(system, x, y)
      call product_of(size(x), size(y), self%map%from_bend, y, next)
      next = linear + next
      if (newton) call self%newton_step(system, x, next, made)
      if (newton .and. .not. made) return
      made = .false.
      change = maxval(abs(next(:n_u) - x(:n_u)))
      size_of = maxval(abs(next(:n_u))) + maxval(abs(self%u))
      x = next
      if (.not. change <= huge(1.0_wp)) return
      if (change <= self%solved*size_of &
          .or. (change >= 0.5_wp*before .and. change <= rounding*size_of)) then
        made = .true.
        return
      end if
      if (turn >= patience .and. change > slow*before) newton = .true.
      before = change
    end do
  end subroutine iterate

  subroutine pack_bends(self, y)
    class(hereditary_type), intent(in) :: self
    real(wp), intent(out) :: y(:)
    integer :: b, s
    s = self%table%s
    do b = 1, size(self%bends, 2)
      y((b - 1)*(s + 1) + 1:b*(s + 1)) = self%bends(1:, b)
    end do
    if (self%map%separable) return
    do b = 1, size(self%remainders, 2)
      y(self%map%at_remainder + (b - 1)*s + 1:self%map%at_remainder + b*s) = self%remainders(:, b)
    end do
  end subroutine pack_bends

  !> y(X), kept in `bends` and `remainders` too.
  subroutine evaluate_bends(self, system, x, y)
    class(hereditary_type), intent(inout) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:)
    real(wp), intent(out) :: y(:)
    real(wp) :: u(self%map%s + 1, self%map%n_dof), w(self%map%s + 1, self%map%n_memory)
    real(wp) :: inner(self%map%s, self%map%n_dof), variables(self%map%s, self%map%n_memory)
    integer :: b, s

    s = self%map%s
    do b = 1, self%map%n_dof
      u(:, b) = self%u(b) + x((b - 1)*(s + 1) + 1:b*(s + 1))
    end do
    if (size(self%map%bent) > 0) call system%deflection_remainder(u, w)
    do b = 1, size(self%map%bent)
      self%bends(1:, b) = w(:, self%map%bent(b))
    end do
    if (.not. self%map%separable) then
      inner = u(:s, :)
      variables = reshape(x(self%map%variable_row:self%map%n_used), [s, self%map%n_memory])
      call system%force_remainder(inner, variables, self%remainders)
    end if
    call pack_bends(self, y)
  end subroutine evaluate_bends

  !> Newton's next X: x + (1 - Z S)^-1 (next - x), S the slopes of y.
  subroutine newton_step(self, system, x, next, made)
    class(hereditary_type), intent(in) :: self
    class(oscillator_type), intent(in) :: system
    real(wp), intent(in) :: x(:)
    real(wp), intent(inout) :: next(:)
    logical, intent(out) :: made
    real(wp) :: u(self%map%s + 1, self%map%n_dof)
    real(wp) :: slopes(self%map%s + 1, self%map%n_memory, self%map%n_dof)
    real(wp) :: inner(self%map%s, self%map%n_dof), variables(self%map%s, self%map%n_memory)
    real(wp) :: by_u(self%map%s, self%map%n_dof, self%map%n_dof)
    real(wp) :: by_v(self%map%s, self%map%n_dof, self%map%n_memory)
    real(wp) :: matrix(self%map%n_used, self%map%n_used), shift(self%map%n_used)
    integer :: pivots(self%map%n_used), a, b, i, j, n, s, row, column
    logical :: singular

    s = self%map%s
    n = self%map%n_used
    do b = 1, self%map%n_dof
      u(:, b) = self%u(b) + x((b - 1)*(s + 1) + 1:b*(s + 1))
    end do
    matrix = 0.0_wp
    do i = 1, n
      matrix(i, i) = 1.0_wp
    end do
    if (size(self%map%bent) > 0) call system%deflection_slopes(u, slopes)
    do b = 1, self%map%n_dof
      do j = 1, size(self%map%bent)
        do i = 1, s + 1
          row = (b - 1)*(s + 1) + i
          column = (j - 1)*(s + 1) + i
          matrix(:, row) = matrix(:, row) &
                           - self%map%from_bend(:n, column)*slopes(i, self%map%bent(j), b)
        end do
      end do
    end do
    if (.not. self%map%separable) then
      inner = u(:s, :)
      variables = reshape(x(self%map%variable_row:n), [s, self%map%n_memory])
      call system%force_slopes(inner, variables, by_u, by_v)
      do a = 1, self%map%n_dof
        do i = 1, s
          column = self%map%at_remainder + (a - 1)*s + i
          do b = 1, self%map%n_dof
            row = (b - 1)*(s + 1) + i
            matrix(:, row) = matrix(:, row) - self%map%from_bend(:n, column)*by_u(i, a, b)
          end do
          do j = 1, self%map%n_memory
            row = self%map%variable_row + (j - 1)*s + i - 1
            matrix(:, row) = matrix(:, row) - self%map%from_bend(:n, column)*by_v(i, a, j)
          end do
        end do
      end do
    end if
    shift = next(:n) - x(:n)
    call factorize(n, matrix, pivots, singular)
    made = .not. singular
    if (singular) return
    call solve(n, matrix, pivots, shift)
    next(:n) = x(:n) + shift
  end subroutine newton_step

  !> out = matrix x, rows in whole registers.
  pure subroutine product_of(n_rows, n, matrix, x, out)
    integer, intent(in) :: n_rows, n
    real(wp), intent(in) :: matrix(n_rows, n), x(n)
    real(wp), intent(out) :: out(n_rows)
    real(wp) :: even(row_block), odd(row_block)
    integer :: c, r

    do r = 1, n_rows, row_block
      even = 0.0_wp
      odd = 0.0_wp
      !GCC$ novector
      do c = 1, n/2
        even = even + matrix(r:r + row_block - 1, 2*c - 1)*x(2*c - 1)
        odd = odd + matrix(r:r + row_block - 1, 2*c)*x(2*c)
      end do
      if (mod(n, 2) == 1) even = even + matrix(r:r + row_block - 1, n)*x(n)
      out(r:r + row_block - 1) = even + odd
    end do
  end subroutine product_of

  !> State a fraction of a step back from its end, by the polynomial of the step.
  subroutine inside(self, theta, u, v)
    class(hereditary_type), intent(in) :: self
    !> In [0, 1], 1 at the end of the last step.
    real(wp), intent(in) :: theta
    real(wp), intent(out) :: u(:), v(:)
    if (self%rolling .or. .not. allocated(self%start%ends)) then
      u = matmul(self%table%basis(theta), self%points)
      v = matmul(self%table%slopes(theta), self%points)/self%h
    else
      call self%start%at(theta*self%h, u, v)
    end if
  end subroutine inside

  pure integer function memory_size(self)
    class(hereditary_type), intent(in) :: self
    memory_size = 3 + 4*size(self%u) + size(self%bends) + size(self%remainders) &
                  + 2*size(self%clock%high)
    if (self%map%n_channels > 0) memory_size = memory_size + self%history%memory_size()
  end function memory_size

  function save_memory(self) result(memory)
    class(hereditary_type), intent(in) :: self
    real(wp) :: memory(self%memory_size()), head(3)
    integer :: n

    head = [merge(1.0_wp, 0.0_wp, self%rolling), self%clock%t, 0.0_wp]
    memory(:3) = head
    n = 3
    call push([self%u, self%v, self%u_rest, self%v_rest])
    call push(reshape(self%bends, [size(self%bends)]))
    call push(reshape(self%remainders, [size(self%remainders)]))
    call push([self%clock%high, self%clock%low])
    if (self%map%n_channels > 0) call push(self%history%save_memory())

  contains

    subroutine push(part)
      real(wp), intent(in) :: part(:)
      memory(n + 1:n + size(part)) = part
      n = n + size(part)
    end subroutine push

  end function save_memory

  subroutine load_memory(self, memory)
    class(hereditary_type), intent(inout) :: self
    real(wp), intent(in) :: memory(:)
    integer :: n, m

    self%rolling = memory(1) > 0.5_wp
    self%clock%t = memory(2)
    n = 3
    m = size(self%u)
    self%u = memory(n + 1:n + m)
    self%v = memory(n + m + 1:n + 2*m)
    self%u_rest = memory(n + 2*m + 1:n + 3*m)
    self%v_rest = memory(n + 3*m + 1:n + 4*m)
    n = n + 4*m
    self%bends(:, :) = reshape(memory(n + 1:n + size(self%bends)), shape(self%bends))
    n = n + size(self%bends)
    self%remainders(:, :) = reshape(memory(n + 1:n + size(self%remainders)), &
                                    shape(self%remainders))
    n = n + size(self%remainders)
    m = size(self%clock%high)
    self%clock%high = memory(n + 1:n + m)
    self%clock%low = memory(n + m + 1:n + 2*m)
    n = n + 2*m
    if (self%map%n_channels > 0) call self%history%load_memory(memory(n + 1:))
  end subroutine load_memory

end module viscovib_hereditary
