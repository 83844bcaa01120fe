! Optimize: -O1
!> Nonpolynomial force laws as terms of a system: their arguments and the equations they act on.
module viscovib_law_term
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: n_lanes
  use viscovib_law_functions, only: divide, f_abs, jumps
  use viscovib_law_program, only: law_program, multiply, put_argument, put_number, subtract, wall
  implicit none
  private

  public :: law_term, about_rest, add_laws, add_law_slopes, new_law_term, part_linear, read_rates

  !> f(A u + A' u') on some equations, each with a weight. Its linear part belongs to the stiffness
  !! and, without a kernel, to the damping.
  type :: law_term
    type(law_program) :: program
    !> A and A', shape (n_arguments, n_dof); A' is 0 if the law depends on no rate.
    real(wp), allocatable :: arguments(:, :), rates(:, :)
    !> A, followed by the columns of A' for all rates that laws depend on (see `read_rates`).
    real(wp), allocatable :: seen(:, :)
    !> Kernel of the law (0: none), its parity (see `parity_of`), and its degree as a polynomial (0:
    !! not a polynomial).
    integer :: kernel = 0, parity = 0, degree = 0
    !> Kind of an element with internal state (0: none, 1: Jenkins element, ...), whose program
    !! contains its parameters. In the frequency domain it is defined over whole cycles only.
    integer :: state = 0
    !> Source text; not allocated if it is not known.
    character(len=:), allocatable :: text
    !> Equations on which the law acts, and their hereditary variables, shape (n_targets).
    integer, allocatable :: equations(:), variables(:)
    real(wp), allocatable :: weights(:)
  contains
    procedure :: drop_unread
    procedure :: part_last
    procedure :: arguments_of_lanes
  end type law_term

  !> Distance from static equilibrium within which a law must have a value.
  real(wp), parameter :: near = 1.0e-9_wp
  !> Within this distance a law may change by its largest slope times `steep`, or by its value,
  !! times the distance. A larger change is accepted if at least the fraction `least_later` occurs
  !! over the second half, so that the law does not jump at equilibrium. Rounding errors of
  !! cancelling parts differ from point to point.
  real(wp), parameter :: steep = 10.0_wp, least_later = 1.0e-2_wp

contains

  !> Subtract the linear part at static equilibrium from a law of all coordinates and rates, and
  !! return it in `slopes`.
  subroutine about_rest(law, slopes, fault)
    !> Its program reads the coordinates, then the rates. Its parity may be lost.
    type(law_term), intent(inout) :: law
    !> Derivatives at equilibrium, shape (2 n_dof); 0 for rates if the law has a kernel.
    real(wp), intent(out) :: slopes(:)
    !> Fault of a law without a unique value near equilibrium, as tanh(1/x), or without a finite
    !! derivative there; empty: none.
    character(len=:), allocatable, intent(out) :: fault
    real(wp) :: at(4*size(slopes) + 1, size(slopes)), value(4*size(slopes) + 1)
    real(wp) :: by(4*size(slopes) + 1, size(slopes)), change(2*size(slopes))
    logical :: defined
    integer :: i, n

    n = size(slopes)
    at = 0.0_wp
    do i = 1, n
      at(1 + i, i) = near
      at(1 + n + i, i) = -near
    end do
    at(2*n + 2:, :) = 0.5_wp*at(2:2*n + 1, :)
    call law%program%differentiate(at, value, by)
    defined = all(abs(value) < wall)
    if (defined .and. .not. any(jumps(law%program%code))) then
      change = abs(value(2:2*n + 1) - value(1))
      defined = all(change <= near*max(steep*maxval(abs(by)), maxval(abs(value))) &
                    .or. abs(value(2:2*n + 1) - value(2*n + 2:)) > least_later*change)
    end if
    slopes = by(1, :)
    if (law%kernel > 0) slopes(n/2 + 1:) = 0.0_wp
    fault = ''
    if (.not. defined) then
      fault = 'must be defined near rest, where its arguments are 0'
      if (any(eoshift(law%program%code, 1) == divide .and. law%program%code == f_abs)) then
        fault = fault//' (u/abs(u) is sign(u) but for u = 0: write sign)'
      end if
    else if (any(abs(slopes) >= wall)) then
      fault = 'must have a finite derivative at rest, where its arguments are 0'
    end if
    if (law%parity == 1 .and. any(abs(slopes) > 0.0_wp)) law%parity = 0
    do i = 1, n
      if (.not. abs(slopes(i)) > 0.0_wp) cycle
      law%program%code = [law%program%code, put_argument, put_number, multiply, subtract]
      law%program%number = [law%program%number, real(i, wp), slopes(i), 0.0_wp, 0.0_wp]
    end do
    call law%program%measure()
  end subroutine about_rest

  !> Remove arguments that the program does not read.
  subroutine drop_unread(self)
    class(law_term), intent(inout) :: self
    integer :: place(size(self%arguments, 1)), i
    logical :: used(size(self%arguments, 1))

    used = .false.
    do i = 1, size(self%program%code)
      if (self%program%code(i) == put_argument) used(nint(self%program%number(i))) = .true.
    end do
    if (.not. any(used)) used(1) = .true.
    place = 0
    place(pack([(i, i=1, size(used))], used)) = [(i, i=1, count(used))]
    do i = 1, size(self%program%code)
      if (self%program%code(i) == put_argument) then
        self%program%number(i) = place(nint(self%program%number(i)))
      end if
    end do
    self%arguments = self%arguments(pack([(i, i=1, size(used))], used), :)
    self%rates = self%rates(pack([(i, i=1, size(used))], used), :)
    self%program%n_arguments = count(used)
  end subroutine drop_unread

  !> Remove the multiples of arguments that the program subtracts last, such as the linear part at
  !! equilibrium. Returns them by coordinates and by rates, shapes (n_dof).
  subroutine part_last(self, by_q, by_v)
    class(law_term), intent(inout) :: self
    real(wp), intent(out) :: by_q(:), by_v(:)
    integer :: k, n

    by_q = 0.0_wp
    by_v = 0.0_wp
    n = size(self%program%code)
    do while (n > 4)
      if (any(self%program%code(n - 3:n) /= [put_argument, put_number, multiply, subtract])) exit
      k = nint(self%program%number(n - 3))
      by_q = by_q - self%program%number(n - 2)*self%arguments(k, :)
      by_v = by_v - self%program%number(n - 2)*self%rates(k, :)
      n = n - 4
    end do
    if (n == size(self%program%code)) return
    self%program%code = self%program%code(:n)
    self%program%number = self%program%number(:n)
    call self%program%measure()
    call self%drop_unread()
  end subroutine part_last

  !> What laws without a state end with is added to M^(-1) K and M^(-1) C instead.
  subroutine part_linear(laws, inverse, stiffness, damping, parted)
    type(law_term), intent(inout) :: laws(:)
    real(wp), intent(in) :: inverse(:, :)
    real(wp), intent(inout) :: stiffness(:, :), damping(:, :)
    !> That part of each law by coordinates, then by rates, shape (2 n_dof, n_laws).
    real(wp), intent(out), optional :: parted(:, :)
    real(wp), dimension(size(inverse, 1)) :: by_q, by_v, weights
    integer :: d, i

    if (present(parted)) parted = 0.0_wp
    do i = 1, size(laws)
      if (laws(i)%state > 0) cycle
      call laws(i)%part_last(by_q, by_v)
      if (present(parted)) parted(:, i) = [by_q, by_v]
      weights = matmul(inverse(:, laws(i)%equations), laws(i)%weights)
      do d = 1, size(weights)
        stiffness(d, :) = stiffness(d, :) + weights(d)*by_q
        damping(d, :) = damping(d, :) + weights(d)*by_v
      end do
    end do
  end subroutine part_linear

  !> Arguments from coordinates and rates, in every vector lane.
  pure function arguments_of_lanes(self, q, v) result(values)
    class(law_term), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, size(self%arguments, 2))
    real(wp), intent(in) :: v(n_lanes, size(self%arguments, 2))
    real(wp) :: values(n_lanes, size(self%arguments, 1))
    integer :: b, k
    values = 0.0_wp
    do b = 1, size(q, 2)
      do k = 1, size(self%arguments, 1)
        if (abs(self%arguments(k, b)) > 0.0_wp) then
          values(:, k) = values(:, k) + self%arguments(k, b)*q(:, b)
        end if
        if (abs(self%rates(k, b)) > 0.0_wp) then
          values(:, k) = values(:, k) + self%rates(k, b)*v(:, b)
        end if
      end do
    end do
  end function arguments_of_lanes

  !> A law from its vector: arguments, equations, instructions, kernel, parity, degree, state; A and
  !! A' (arguments x n_dof); equation and weight of targets; code and number of instructions.
  subroutine new_law_term(law, vector, n_dof, used)
    type(law_term), intent(out) :: law
    real(wp), intent(in) :: vector(:)
    integer, intent(in) :: n_dof
    !> Number of entries read.
    integer, intent(out) :: used
    integer :: m, k, n

    m = nint(vector(1))
    k = nint(vector(2))
    n = nint(vector(3))
    law%kernel = nint(vector(4))
    law%parity = nint(vector(5))
    law%degree = nint(vector(6))
    law%state = nint(vector(7))
    used = 7
    law%arguments = reshape(vector(used + 1:used + m*n_dof), [m, n_dof])
    used = used + m*n_dof
    law%rates = reshape(vector(used + 1:used + m*n_dof), [m, n_dof])
    used = used + m*n_dof
    law%equations = nint(vector(used + 1:used + 2*k:2))
    law%weights = vector(used + 2:used + 2*k:2)
    allocate (law%variables(k), source=0)
    used = used + 2*k
    law%program%n_arguments = m
    law%program%code = nint(vector(used + 1:used + 2*n:2))
    law%program%number = vector(used + 2:used + 2*n:2)
    used = used + 2*n
    call law%program%measure()
  end subroutine new_law_term

  !> Coordinates whose rates appear in laws, and the matrices `seen` of the laws, which act on all
  !! coordinates followed by these rates.
  pure subroutine read_rates(laws, n_dof, rates)
    type(law_term), intent(inout) :: laws(:)
    integer, intent(in) :: n_dof
    integer, allocatable, intent(out) :: rates(:)
    logical :: read_by(n_dof)
    integer :: i, j

    read_by = .false.
    do i = 1, size(laws)
      read_by = read_by .or. any(abs(laws(i)%rates) > 0.0_wp, 1)
    end do
    rates = pack([(i, i=1, n_dof)], read_by)
    do i = 1, size(laws)
      if (allocated(laws(i)%seen)) deallocate (laws(i)%seen)
      allocate (laws(i)%seen(size(laws(i)%arguments, 1), n_dof + size(rates)))
      laws(i)%seen(:, :n_dof) = laws(i)%arguments
      do j = 1, size(rates)
        laws(i)%seen(:, n_dof + j) = laws(i)%rates(:, rates(j))
      end do
    end do
  end subroutine read_rates

  !> Add the laws to their hereditary variables.
  subroutine add_laws(laws, polynomials, u, w)
    type(law_term), intent(in) :: laws(:)
    !> True: only polynomial laws; false: only nonpolynomial laws.
    logical, intent(in) :: polynomials
    !> Coordinates and the rates that laws depend on, shape (n_samples, n_seen), and hereditary
    !! variables, (n_samples, n_memory).
    real(wp), intent(in) :: u(:, :)
    real(wp), intent(inout) :: w(:, :)
    real(wp) :: value(size(u, 1))
    integer :: i, j

    do i = 1, size(laws)
      if (laws(i)%state > 0 .or. (laws(i)%degree > 0 .neqv. polynomials)) cycle
      associate (law => laws(i))
        call law%program%evaluate(matmul(u, transpose(law%seen)), value)
        do j = 1, size(law%variables)
          w(:, law%variables(j)) = w(:, law%variables(j)) + law%weights(j)*value
        end do
      end associate
    end do
  end subroutine add_laws

  !> Add the derivatives of laws by the coordinates and rates.
  subroutine add_law_slopes(laws, polynomials, u, slopes)
    type(law_term), intent(in) :: laws(:)
    logical, intent(in) :: polynomials
    real(wp), intent(in) :: u(:, :)
    !> Shape (n_samples, n_memory, n_seen).
    real(wp), intent(inout) :: slopes(:, :, :)
    real(wp) :: value(size(u, 1)), by_coordinate(size(u, 1), size(u, 2))
    real(wp), allocatable :: by_argument(:, :)
    integer :: b, i, j

    do i = 1, size(laws)
      if (laws(i)%state > 0 .or. (laws(i)%degree > 0 .neqv. polynomials)) cycle
      associate (law => laws(i))
        allocate (by_argument(size(u, 1), law%program%n_arguments))
        call law%program%differentiate(matmul(u, transpose(law%seen)), value, by_argument)
        by_coordinate = matmul(by_argument, law%seen)
        deallocate (by_argument)
        do b = 1, size(u, 2)
          do j = 1, size(law%variables)
            slopes(:, law%variables(j), b) = slopes(:, law%variables(j), b) &
                                             + law%weights(j)*by_coordinate(:, b)
          end do
        end do
      end associate
    end do
  end subroutine add_law_slopes

end module viscovib_law_term
