!> A polynomial system without memory in time, under a periodic load and a piecewise cubic
!! in time:
!!
!!   M u'' = Im sum_k P_k exp(i k nu t) + F(t) - C u' - K u - f(u).
!!
!! Its drives are cos(nu t) and sin(nu t); those of higher orders follow by rotation. The
!! third, where F is given, is the time since the present piece of it began.
module viscovib_polynomial_motion
  use viscovib_dense, only: invert
  use viscovib_driven_system, only: driven_system_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  use viscovib_law_branches, only: find_signals, held, signal_type
  use viscovib_law_program, only: law_program
  use viscovib_law_term, only: law_term
  use viscovib_load, only: load_type
  use viscovib_polynomial, only: monomial_type, multiply, polynomial_type
  use viscovib_status, only: fail, show, status_input_error, status_type
  implicit none
  private

  public :: polynomial_motion_type, new_polynomial_motion

  type, extends(driven_system_type) :: polynomial_motion_type
    type(monomial_type), allocatable, private :: monomials(:)
    !> The laws, with their branches held, and as they are.
    type(law_term), allocatable, private :: laws(:), free_laws(:)
    !> M^(-1), M^(-1) K and M^(-1) C, shape (n_dof, n_dof).
    real(wp), allocatable, private :: inverse(:, :), stiffness(:, :), damping(:, :)
    !> M^(-1) P_k, shape (n_dof, size(orders)), and orders, ascending.
    complex(wp), allocatable, private :: load(:, :)
    integer, allocatable, private :: orders(:)
    !> M^(-1) F, sum_p pieces(:,p,i) (t - breaks(i))^(4-p), shape (n_dof, 4, n); nothing
    !! before the first break and after the last. The present piece, from `enter` on.
    real(wp), allocatable, private :: breaks(:), pieces(:, :, :), piece(:, :)
  contains
    procedure :: acceleration
    procedure :: margin
    procedure :: fastest
    procedure :: add_table
    procedure :: enter
    procedure :: take_sides
  end type polynomial_motion_type

contains

  subroutine new_polynomial_motion(motion, system, load, nu, status)
    type(polynomial_motion_type), intent(out) :: motion
    type(polynomial_type), intent(in) :: system
    !> Forces on the coordinates; the base is at rest.
    type(load_type), intent(in) :: load
    !> Circular frequency of the load (rad/s), > 0.
    real(wp), intent(in) :: nu
    type(status_type), intent(out) :: status
    complex(wp) :: inverse(system%n_dof(), system%n_dof())
    logical :: singular
    integer :: i

    if (system%n_dof() > max_dof) then
      call fail(status, status_input_error, 'system', 'system: has '//show(system%n_dof()) &
                //' coordinates, motion in time takes at most '//show(max_dof))
    else if (any(system%kernel_of > 0)) then
      call fail(status, status_input_error, 'system', 'system: has memory, motion in time is ' &
                //'computed without: leave out the kernels')
    else if (load%moves_base()) then
      call fail(status, status_input_error, 'base', 'base: must be at rest in motion in time')
    end if
    if (status%failed()) return
    motion%n_dof = system%n_dof()
    motion%monomials = system%monomials
    motion%laws = system%laws
    call invert(cmplx(system%mass, 0.0_wp, wp), inverse, singular)
    motion%inverse = real(inverse)
    motion%stiffness = matmul(motion%inverse, system%stiffness_at_rest())
    motion%damping = matmul(motion%inverse, system%damping)
    motion%orders = load%orders
    motion%load = matmul(motion%inverse, load%force)
    motion%drives = [(nu, i=1, 2)]
    motion%quarters = [0, 3]
    motion%limited = .false.
    motion%free_laws = motion%laws
    call find_surfaces(motion, [integer ::])
  end subroutine new_polynomial_motion

  !> Hold the laws on one side of each of their surfaces.
  subroutine take_sides(self, sides)
    class(polynomial_motion_type), intent(inout) :: self
    integer, intent(in) :: sides(:)
    integer :: i, k, n

    k = 0
    do i = 1, size(self%free_laws)
      associate (law => self%free_laws(i)%program)
        n = law%n_surfaces()
        self%laws(i)%program = held(law, sides(k + 1:k + n))
        k = k + n
      end associate
    end do
    call find_surfaces(self, sides)
  end subroutine take_sides

  !> The surfaces of all laws, seen from these sides.
  subroutine find_surfaces(self, sides)
    class(polynomial_motion_type), intent(inout) :: self
    integer, intent(in) :: sides(:)
    type(signal_type), allocatable :: signals(:)
    type(law_program), allocatable :: programs(:)
    integer :: i, j, k, n

    n = 0
    do i = 1, size(self%free_laws)
      n = n + self%free_laws(i)%program%n_surfaces()
    end do
    if (n == 0) return
    allocate (signals(n))
    k = 0
    do i = 1, size(self%free_laws)
      associate (law => self%free_laws(i))
        n = law%program%n_surfaces()
        if (size(sides) > 0) then
          call find_signals(law%program, sides(k + 1:k + n), programs)
        else
          call find_signals(law%program, sides, programs)
        end if
        do j = 1, n
          signals(k + j)%program = programs(j)
          signals(k + j)%by_q = law%arguments
          signals(k + j)%by_v = law%rates
        end do
        k = k + n
      end associate
    end do
    call move_alloc(signals, self%signals)
  end subroutine find_surfaces

  !> A force in time besides the periodic load, as cubics between breaks.
  subroutine add_table(self, breaks, pieces)
    class(polynomial_motion_type), intent(inout) :: self
    !> Shapes (n) and (n_dof, 4, n), the last one of no effect.
    real(wp), intent(in) :: breaks(:), pieces(:, :, :)
    integer :: i
    self%breaks = breaks
    self%pieces = pieces
    do i = 1, size(breaks)
      self%pieces(:, :, i) = matmul(self%inverse, pieces(:, :, i))
    end do
    allocate (self%piece(self%n_dof, 4))
    self%piece = 0.0_wp
    self%timed = .true.
    self%drives = [self%drives, 0.0_wp]
    self%quarters = [self%quarters, 0]
  end subroutine add_table

  !> The cubic at the middle of a piece of time, in powers of the time since it began.
  subroutine enter(self, from, to)
    class(polynomial_motion_type), intent(inout) :: self
    real(wp), intent(in) :: from, to
    real(wp) :: middle, shift
    integer :: i

    self%present_piece = [from, to]
    if (.not. self%timed) return
    self%piece = 0.0_wp
    middle = 0.5_wp*(from + to)
    if (middle < self%breaks(1) .or. middle > self%breaks(size(self%breaks))) return
    i = 1
    do while (i < size(self%breaks) - 1 .and. middle >= self%breaks(i + 1))
      i = i + 1
    end do
    shift = from - self%breaks(i)
    associate (a => self%pieces(:, :, i))
      self%piece(:, 1) = a(:, 1)
      self%piece(:, 2) = a(:, 2) + 3.0_wp*shift*a(:, 1)
      self%piece(:, 3) = a(:, 3) + shift*(2.0_wp*a(:, 2) + 3.0_wp*shift*a(:, 1))
      self%piece(:, 4) = a(:, 4) + shift*(a(:, 3) + shift*(a(:, 2) + shift*a(:, 1)))
    end associate
  end subroutine enter

  pure subroutine acceleration(self, q, v, drive, a)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof), v(n_lanes, self%n_dof)
    real(wp), intent(in) :: drive(n_lanes, size(self%drives))
    real(wp), intent(out) :: a(n_lanes, self%n_dof)
    real(wp) :: product(n_lanes), c(n_lanes), s(n_lanes), part(n_lanes)
    integer :: b, d, i, j, k, order

    do d = 1, self%n_dof
      product = 0.0_wp
      do b = 1, self%n_dof
        product = product - (self%stiffness(d, b)*q(:, b) + self%damping(d, b)*v(:, b))
      end do
      a(:, d) = product
    end do
    do i = 1, size(self%monomials)
      associate (m => self%monomials(i))
        product = m%coefficient
        do j = 1, size(m%dof)
          call multiply(product, q(:, m%dof(j)), m%power(j))
        end do
        do d = 1, self%n_dof
          if (abs(self%inverse(d, m%equation)) > 0.0_wp) then
            a(:, d) = a(:, d) - self%inverse(d, m%equation)*product
          end if
        end do
      end associate
    end do
    do i = 1, size(self%laws)
      associate (law => self%laws(i))
        call law%program%evaluate(matmul(q, transpose(law%arguments)) &
                                  + matmul(v, transpose(law%rates)), product)
        do d = 1, self%n_dof
          a(:, d) = a(:, d) - dot_product(self%inverse(d, law%equations), law%weights)*product
        end do
      end associate
    end do
    ! cos and sin of the order reached so far.
    order = 0
    c = 1.0_wp
    s = 0.0_wp
    do k = 1, size(self%orders)
      do while (order < self%orders(k))
        part = c*drive(:, 1) - s*drive(:, 2)
        s = s*drive(:, 1) + c*drive(:, 2)
        c = part
        order = order + 1
      end do
      do d = 1, self%n_dof
        a(:, d) = a(:, d) + (real(self%load(d, k))*s + aimag(self%load(d, k))*c)
      end do
    end do
    if (.not. self%timed) return
    do d = 1, self%n_dof
      a(:, d) = a(:, d) + (((self%piece(d, 1)*drive(:, 3) + self%piece(d, 2))*drive(:, 3) &
                            + self%piece(d, 3))*drive(:, 3) + self%piece(d, 4))
    end do
  end subroutine acceleration

  !> The equations hold everywhere.
  pure function margin(self, q)
    class(polynomial_motion_type), intent(in) :: self
    real(wp), intent(in) :: q(n_lanes, self%n_dof)
    real(wp) :: margin(n_lanes)
    margin = 1.0_wp + 0.0_wp*q(:, 1)
  end function margin

  !> Upper bound of the rates of the linear system, and the frequency of the load
  !! (rad/s): what steps begin with.
  pure real(wp) function fastest(self)
    class(polynomial_motion_type), intent(in) :: self
    fastest = max(sqrt(maxval(sum(abs(self%stiffness), 2))) + maxval(sum(abs(self%damping), 2)), &
                  self%drives(1))
  end function fastest

end module viscovib_polynomial_motion
