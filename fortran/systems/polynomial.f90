! Optimize: -O2 -fvect-cost-model=dynamic
!> A system of n degrees of freedom with polynomial forces, as defined by the user:
!!
!!   M u'' + C u' + sum_g (1 - R_g*) [K_g u + f_g(u)] = load(t).
!!
!! Each f_g is a sum of monomials c prod_d u_d^p_d of degree 2 or more on chosen equations, and of
!! nonpolynomial laws given as text. All springs and forces with one kernel R_g form a group. The
!! hereditary variables are the forces of each group on each equation, so that F = B v, with a
!! column of the unit matrix for each variable.
module viscovib_polynomial
  use viscovib_checks, only: check_finite
  use viscovib_counters, only: count_up, counted_deflections, counted_monomials, counting
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_limits, only: least_mass
  use viscovib_law_term, only: add_law_slopes, add_laws, law_term, read_rates
  use viscovib_modal_frame, only: most_in_frame
  use viscovib_oscillator, only: oscillator_type
  use viscovib_shaft, only: shaft_type
  use viscovib_speed_matrices, only: speed_matrices
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: monomial_type, polynomial_type, polynomial_parameters, new_polynomial, multiply
  public :: highest_degree

  !> Limits on the size of the system.
  integer, parameter, public :: max_coordinates = 64, max_degree = 15

  type, extends(speed_matrices) :: polynomial_parameters
    !> M and C, shape (n, n).
    real(wp), allocatable :: mass(:, :), damping(:, :)
    !> K of each spring group, shape (n, n, n_springs), and its kernel (0: none).
    real(wp), allocatable :: stiffness(:, :, :)
    integer, allocatable :: spring_kernel(:)
    !> Monomials: c, equation, kernel, and powers, shape (n, n_monomials).
    real(wp), allocatable :: coefficient(:)
    integer, allocatable :: on(:), monomial_kernel(:), powers(:, :)
    !> Displacement of u per unit base displacement, shape (n); all 0: fixed base.
    real(wp), allocatable :: base_direction(:)
    !> Parts of C, and additional forces, that refer to inertial space and not to a moving base,
    !! shapes (n_dof, n_dof); not allocated: none.
    real(wp), allocatable :: space_damping(:, :), space_stiffness(:, :)
    !> Nonpolynomial forces; not allocated: none.
    type(law_term), allocatable :: laws(:)
  contains
    procedure :: resize_monomials
  end type polynomial_parameters

  !> c prod u_dof^power, dof and power of its factors.
  type :: monomial_type
    real(wp) :: coefficient = 0.0_wp
    integer :: equation = 0, variable = 0
    integer, allocatable :: dof(:), power(:)
  end type monomial_type

  type, extends(oscillator_type) :: polynomial_type
    type(monomial_type), allocatable :: monomials(:)
    type(law_term), allocatable :: laws(:)
    !> The shaft whose angle is the last coordinate; not allocated: none. Only motions in time
    !! include it.
    type(shaft_type), allocatable :: shaft
  contains
    procedure :: deflection_remainder
    procedure :: force_remainder
    procedure :: deflection_slopes
    procedure :: sampled_remainder
    procedure :: sampled_slopes
    procedure :: force_slopes
    procedure :: coupling
    procedure :: stiffness_at_rest
    procedure :: is_linear
  end type polynomial_type

contains

  !> Checked constructor.
  subroutine new_polynomial(system, parameters, kernels, status)
    type(polynomial_type), intent(out) :: system
    type(polynomial_parameters), intent(in) :: parameters
    type(kernel_holder), intent(in) :: kernels(:)
    type(status_type), intent(out) :: status
    integer :: i, j

    call check_parameters(parameters, size(kernels), status)
    if (status%failed()) return
    system%mass = parameters%mass
    system%damping = parameters%damping
    system%base_direction = parameters%base_direction
    if (allocated(parameters%space_damping)) then
      system%space_damping = parameters%space_damping
      system%space_stiffness = parameters%space_stiffness
    end if
    call system%take_matrices(parameters, status)
    if (status%failed()) return
    call copy_kernels(kernels, system%kernels)
    allocate (system%monomials(count(abs(parameters%coefficient) > 0.0_wp)))
    j = 0
    do i = 1, size(parameters%coefficient)
      if (.not. abs(parameters%coefficient(i)) > 0.0_wp) cycle
      j = j + 1
      call set_monomial(system%monomials(j), parameters%coefficient(i), parameters%on(i), &
                        parameters%powers(:, i))
    end do
    associate (degrees => pack(sum(parameters%powers, 1), abs(parameters%coefficient) > 0.0_wp))
      system%odd = all(mod(degrees, 2) == 1)
      system%degree = max(1, maxval(degrees))
    end associate
    system%n_zero = size(parameters%coefficient) - size(system%monomials)
    allocate (system%laws(0))
    if (allocated(parameters%laws)) system%laws = parameters%laws
    if (size(system%laws) > 0) then
      system%odd = system%odd .and. all(system%laws%parity == -1)
      if (all(system%laws%degree > 0)) then
        system%degree = max(system%degree, maxval(system%laws%degree))
      else
        system%degree = 0
      end if
    end if
    call read_rates(system%laws, size(system%mass, 1), system%rates)
    call add_variables(system, parameters, size(kernels))
    call system%drop_zero_kernels()
  end subroutine new_polynomial

  !> True if all forces are linear.
  pure logical function is_linear(self)
    class(polynomial_type), intent(in) :: self
    is_linear = size(self%monomials) + size(self%laws) == 0
  end function is_linear

  !> Change the capacity for monomials.
  pure subroutine resize_monomials(self, n)
    class(polynomial_parameters), intent(inout) :: self
    integer, intent(in) :: n
    integer, allocatable :: powers(:, :)
    integer :: i, kept

    kept = min(n, size(self%coefficient))
    self%coefficient = [self%coefficient(:kept), (0.0_wp, i=kept + 1, n)]
    self%on = [self%on(:kept), (0, i=kept + 1, n)]
    self%monomial_kernel = [self%monomial_kernel(:kept), (0, i=kept + 1, n)]
    allocate (powers(size(self%powers, 1), n), source=0)
    powers(:, :kept) = self%powers(:, :kept)
    call move_alloc(powers, self%powers)
  end subroutine resize_monomials

  subroutine check_parameters(p, n_kernels, status)
    type(polynomial_parameters), intent(in) :: p
    integer, intent(in) :: n_kernels
    type(status_type), intent(out) :: status
    integer :: n, i, total

    n = size(p%mass, 1)
    if (n < 1 .or. n > most_in_frame) then
      call fail(status, status_input_error, 'mass', 'mass: is for '//show(n) &
                //' coordinates, must be for 1 to '//show(most_in_frame))
      return
    end if
    call check_finite('mass', reshape(p%mass, [size(p%mass)]), status)
    if (status%failed()) return
    call check_mass(p%mass, status)
    if (status%failed()) return
    call check_finite('damping', reshape(p%damping, [size(p%damping)]), status)
    if (status%failed()) return
    call check_finite('stiffness', reshape(p%stiffness, [size(p%stiffness)]), status)
    if (status%failed()) return
    call check_finite('base_direction', p%base_direction, status)
    if (status%failed()) return
    call check_finite('coefficient', p%coefficient, status)
    if (status%failed()) return
    do i = 1, size(p%coefficient)
      total = sum(min(p%powers(:, i), max_degree + 1))
      if (any(p%powers(:, i) < 0) .or. total < 2 .or. total > max_degree) then
        call fail(status, status_input_error, 'powers', 'powers of monomial '//show(i) &
                  //': must not be negative, and their sum 2 to '//show(max_degree) &
                  //' (what is linear belongs to the stiffness)')
      else if (p%on(i) < 1 .or. p%on(i) > n) then
        call fail(status, status_input_error, 'on', 'on = '//show(p%on(i)) &
                  //': must be an equation, 1 to '//show(n))
      end if
      if (status%failed()) return
    end do
    if (allocated(p%laws)) then
      do i = 1, size(p%laws)
        if (p%laws(i)%kernel < 0 .or. p%laws(i)%kernel > n_kernels) then
          call fail(status, status_input_error, 'kernel', 'kernel: must be 0 (none) to ' &
                    //show(n_kernels))
          return
        end if
      end do
    end if
    if (any([p%spring_kernel, p%monomial_kernel] < 0) &
        .or. any([p%spring_kernel, p%monomial_kernel] > n_kernels)) then
      call fail(status, status_input_error, 'kernel', 'kernel: must be 0 (none) to ' &
                //show(n_kernels))
    end if
  end subroutine check_parameters

  !> Check that the mass is symmetric, with positive Cholesky pivots.
  subroutine check_mass(mass, status)
    real(wp), intent(in) :: mass(:, :)
    type(status_type), intent(inout) :: status
    character(len=*), parameter :: wanted = 'mass: must be symmetric and positive definite'
    real(wp) :: a(size(mass, 1), size(mass, 1))
    integer :: j, k, at(2)

    a = abs(mass - transpose(mass))
    if (any(a > 1.0e-12_wp*maxval(abs(mass)))) then
      at = maxloc(a)
      associate (i => minval(at), j => maxval(at))
        call fail(status, status_input_error, 'mass', wanted//', has '//show(mass(i, j)) &
                  //' in row '//show(i)//', column '//show(j)//' and '//show(mass(j, i)) &
                  //' in row '//show(j)//', column '//show(i))
      end associate
      return
    end if
    a = mass
    do k = 1, size(a, 1)
      if (mass(k, k) > 0.0_wp .and. mass(k, k) < least_mass) then
        call fail(status, status_input_error, 'mass', 'mass: has '//show(mass(k, k))//' in row ' &
                  //show(k)//', must be at least '//show(least_mass)//': choose other units')
        return
      end if
      if (.not. a(k, k) > 4.0_wp*epsilon(1.0_wp)*mass(k, k)) then
        call fail(status, status_input_error, 'mass', wanted//', has too small a diagonal ' &
                  //show(mass(k, k))//' in row '//show(k))
        return
      end if
      do j = k + 1, size(a, 1)
        a(j:, j) = a(j:, j) - a(j:, k)*(a(j, k)/a(k, k))
      end do
    end do
  end subroutine check_mass

  pure subroutine set_monomial(monomial, coefficient, equation, powers)
    type(monomial_type), intent(inout) :: monomial
    real(wp), intent(in) :: coefficient
    integer, intent(in) :: equation, powers(:)
    integer :: d
    monomial%coefficient = coefficient
    monomial%equation = equation
    monomial%dof = pack([(d, d=1, size(powers))], powers > 0)
    monomial%power = pack(powers, powers > 0)
  end subroutine set_monomial

  !> Define one hereditary variable for each pair of kernel and equation with a force.
  subroutine add_variables(system, p, n_kernels)
    type(polynomial_type), intent(inout) :: system
    type(polynomial_parameters), intent(in) :: p
    integer, intent(in) :: n_kernels
    real(wp) :: stiffness(size(p%mass, 1), size(p%mass, 1))
    integer :: kernel_of((n_kernels + 1)*size(p%mass, 1)), equation((n_kernels + 1)*size(p%mass, 1))
    real(wp) :: rows((n_kernels + 1)*size(p%mass, 1), size(p%mass, 1))
    logical :: bent((n_kernels + 1)*size(p%mass, 1)), turning(size(p%mass, 1))
    integer :: a, i, j, k, m

    turning = .false.
    if (system%depends_on_speed()) turning = any(abs(system%circulatory) > 0.0_wp &
                                                 .or. abs(system%centrifugal) > 0.0_wp, 2)
    m = 0
    do k = 0, n_kernels
      stiffness = 0.0_wp
      do i = 1, size(p%spring_kernel)
        if (p%spring_kernel(i) == k) stiffness = stiffness + p%stiffness(:, :, i)
      end do
      do a = 1, size(p%mass, 1)
        m = m + 1
        kernel_of(m) = k
        equation(m) = a
        rows(m, :) = stiffness(a, :)
        bent(m) = .false.
        j = 0
        do i = 1, size(p%coefficient)
          if (.not. abs(p%coefficient(i)) > 0.0_wp) cycle
          j = j + 1
          if (p%monomial_kernel(i) /= k .or. p%on(i) /= a) cycle
          bent(m) = .true.
          system%monomials(j)%variable = m
        end do
        do i = 1, size(system%laws)
          if (system%laws(i)%kernel /= k) cycle
          bent(m) = bent(m) .or. any(system%laws(i)%equations == a)
          where (system%laws(i)%equations == a) system%laws(i)%variables = m
        end do
        if (k == 0 .and. turning(a)) cycle
        if (.not. bent(m) .and. .not. any(abs(rows(m, :)) > 0.0_wp)) m = m - 1
      end do
    end do
    system%kernel_of = kernel_of(:m)
    system%bent = bent(:m)
    system%gather = rows(:m, :)
    allocate (system%spread(size(p%mass, 1), m), source=0.0_wp)
    do j = 1, m
      system%spread(equation(j), j) = 1.0_wp
    end do
  end subroutine add_variables

  !> Nonlinear part of w(u): monomials and laws of each group on each equation.
  subroutine deflection_remainder(self, u, w)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    call self%sampled_remainder(u, w)
    if (size(self%laws) > 0) call add_laws(self%laws, .false., u, w)
  end subroutine deflection_remainder

  !> The polynomial part only; harmonic balance integrates the other laws separately.
  subroutine sampled_remainder(self, u, w)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: w(:, :)
    real(wp) :: product(size(u, 1))
    integer :: i, j

    if (counting) call count_up(counted_deflections, size(u, 1))
    do j = 1, size(w, 2)
      if (self%bent(j)) w(:, j) = 0.0_wp
    end do
    do i = 1, size(self%monomials)
      associate (m => self%monomials(i))
        if (counting) call count_up(counted_monomials, size(u, 1))
        product = m%coefficient
        do j = 1, size(m%dof)
          call multiply(product, u(:, m%dof(j)), m%power(j))
        end do
        w(:, m%variable) = w(:, m%variable) + product
      end associate
    end do
    if (size(self%laws) > 0) call add_laws(self%laws, .true., u, w)
  end subroutine sampled_remainder

  !> product x^power.
  pure subroutine multiply(product, x, power)
    real(wp), intent(inout) :: product(:)
    real(wp), intent(in) :: x(:)
    integer, intent(in) :: power
    integer :: k
    select case (power)
    case (1)
      product = product*x
    case (2)
      product = product*x*x
    case (3)
      product = product*x*x*x
    case default
      do k = 1, power
        product = product*x
      end do
    end select
  end subroutine multiply

  !> Zero: F = B v.
  subroutine force_remainder(self, u, v, f)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: f(:, :)
    associate (never_called => self%separable, not_needed => [size(u), size(v)])
      f = 0.0_wp
    end associate
  end subroutine force_remainder

  !> Slopes c p_b u_b^(p_b - 1) prod_d/=b u_d^p_d, and derivatives of laws.
  subroutine deflection_slopes(self, u, slopes)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    call self%sampled_slopes(u, slopes)
    if (size(self%laws) > 0) call add_law_slopes(self%laws, .false., u, slopes)
  end subroutine deflection_slopes

  !> Slopes of the polynomial part.
  subroutine sampled_slopes(self, u, slopes)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :)
    real(wp), intent(inout), contiguous :: slopes(:, :, :)
    real(wp) :: product(size(u, 1))
    integer :: b, i, j

    if (counting) call count_up(counted_deflections, size(u, 1))
    do b = 1, size(u, 2)
      do j = 1, size(slopes, 2)
        if (self%bent(j)) slopes(:, j, b) = 0.0_wp
      end do
    end do
    do i = 1, size(self%monomials)
      associate (m => self%monomials(i))
        do b = 1, size(m%dof)
          product = m%coefficient*m%power(b)
          do j = 1, size(m%dof)
            if (j == b .and. m%power(j) == 1) cycle
            call multiply(product, u(:, m%dof(j)), m%power(j) - merge(1, 0, j == b))
          end do
          slopes(:, m%variable, m%dof(b)) = slopes(:, m%variable, m%dof(b)) + product
        end do
      end associate
    end do
    if (size(self%laws) > 0) call add_law_slopes(self%laws, .true., u, slopes)
  end subroutine sampled_slopes

  subroutine force_slopes(self, u, v, by_u, by_v)
    class(polynomial_type), intent(in) :: self
    real(wp), intent(in), contiguous :: u(:, :), v(:, :)
    real(wp), intent(out), contiguous :: by_u(:, :, :), by_v(:, :, :)
    associate (never_called => self%separable, not_needed => [size(u), size(v)])
      by_u = 0.0_wp
      by_v = 0.0_wp
    end associate
  end subroutine force_slopes

  !> Coordinates coupled by springs, products or laws.
  pure function coupling(self) result(coupled)
    class(polynomial_type), intent(in) :: self
    logical :: coupled(size(self%gather, 2), size(self%gather, 2))
    logical :: touched(size(self%gather, 2))
    integer :: i, j

    coupled = self%linear_coupling() .or. allocated(self%shaft)
    do i = 1, size(self%monomials)
      associate (together => [self%monomials(i)%equation, self%monomials(i)%dof])
        coupled(together, together) = .true.
      end associate
    end do
    do i = 1, size(self%laws)
      associate (law => self%laws(i))
        touched = any(abs(law%arguments) > 0.0_wp .or. abs(law%rates) > 0.0_wp, 1)
        touched(law%equations) = .true.
        do j = 1, size(touched)
          if (touched(j)) coupled(:, j) = coupled(:, j) .or. touched
        end do
      end associate
    end do
  end function coupling

  !> sum_g K_g, shape (n, n): the stiffness without memory.
  pure function stiffness_at_rest(self) result(stiffness)
    class(polynomial_type), intent(in) :: self
    real(wp) :: stiffness(size(self%mass, 1), size(self%mass, 1))
    stiffness = matmul(self%spread, self%gather)
  end function stiffness_at_rest

  !> Highest degree of monomials; 1 if there are none.
  pure integer function highest_degree(monomials)
    type(monomial_type), intent(in) :: monomials(:)
    integer :: i
    highest_degree = 1
    do i = 1, size(monomials)
      highest_degree = max(highest_degree, sum(monomials(i)%power))
    end do
  end function highest_degree

end module viscovib_polynomial
