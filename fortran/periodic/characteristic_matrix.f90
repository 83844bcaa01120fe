! Optimize: -O2 -fvect-cost-model=dynamic
!> The matrix of free linear motion u = x exp(s t) about the equilibrium,
!!
!!   D(s) = s^2 M + s C + sum_g (K_g + s C_g) [1 - R_g(s)],
!!
!! with the kernels R_g of its springs, and the determinant of D. C_g is the linear part of forces
!! with memory in the rates. Rows and columns are divided by the roots of the diagonal of M.
module viscovib_characteristic_matrix
  use viscovib_dense, only: factorize, solve_columns
  use viscovib_eigenvalues, only: eigenvalues
  use viscovib_hidden_memory, only: fades_by_exponentials
  use viscovib_kernel, only: kernel_type
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_kernel_sum, only: kernel_sum
  use viscovib_kinds, only: wp
  use viscovib_oscillator, only: oscillator_type
  use viscovib_rzhanitsyn, only: rzhanitsyn_kernel
  use viscovib_status, only: fail, set_ok, show, status_input_error, status_type
  use viscovib_structure, only: structure_type
  use viscovib_structure_model, only: add_linear, structure_model
  use viscovib_symmetric_modes, only: find_symmetric_modes
  use viscovib_tabulated, only: tabulated_kernel
  implicit none
  private

  public :: characteristic_matrix, oscillator_matrix, structure_matrix

  !> Frequencies below this fraction of the highest one count as 0.
  real(wp), parameter :: no_frequency = 1.0e-7_wp
  !> Fractions of squared forces, and of forces, of springs and dampers that are rounding errors.
  real(wp), parameter :: no_square = 1.0e-14_wp, no_force = 1.0e-12_wp
  !> Largest number of coordinates of a structure: the matrices are full.
  integer, parameter :: most_coordinates = 100

  type :: characteristic_matrix
    real(wp), allocatable :: mass(:, :), damping(:, :)
    !> K_g and C_g, shape (n, n, 0:n_kernels); g = 0: without memory.
    real(wp), allocatable :: stiffness(:, :, :), dampers(:, :, :)
    !> The kernels of springs with nonzero K_g or C_g.
    type(kernel_holder), allocatable :: kernels(:)
    !> Lowest and highest rate (1/s) of the system without memory.
    real(wp) :: slowest = 1.0_wp, fastest = 1.0_wp
    !> True if a kernel is a table: its transform has infinitely many zeros far to the left.
    logical :: has_table = .false.
    logical :: is_symmetric = .true.
    !> Number of motions that no spring and no damper resists. With memory the matrices do not
    !! contain them; each has the root 0 twice.
    integer :: n_rigid = 0
    !> s = -cut is the branch point of Koltunov-Rzhanitsyn kernels (1/s); 0 for other kernels.
    real(wp) :: cut = 0.0_wp
  contains
    procedure :: n_dof
    procedure :: remembers
    procedure :: retained
    procedure :: at
    procedure :: determinants
    procedure :: without_memory
    procedure :: is_sum_of_exponentials
    procedure :: state_matrix
  end type characteristic_matrix

contains

  !> The matrix of an oscillator about the equilibrium.
  subroutine oscillator_matrix(matrix, system, status)
    type(characteristic_matrix), intent(out) :: matrix
    class(oscillator_type), intent(in) :: system
    type(status_type), intent(out) :: status
    real(wp), allocatable :: stiffness(:, :, :), dampers(:, :, :)

    call find_springs(system, stiffness, dampers)
    call new_characteristic_matrix(matrix, system%mass, system%damping, stiffness, dampers, &
                                   system%kernels, status)
  end subroutine oscillator_matrix

  !> The matrix of a structure in all of its coordinates.
  subroutine structure_matrix(matrix, model, system, status)
    type(characteristic_matrix), intent(out) :: matrix
    type(structure_model), intent(in) :: model
    !> The elements of the structure with memory and laws.
    type(structure_type), intent(in) :: system
    type(status_type), intent(out) :: status
    real(wp), dimension(size(model%mass, 1), size(model%mass, 1)) :: stiffness, damping, shapes
    real(wp) :: squares(size(model%mass, 1))
    real(wp), allocatable :: springs(:, :, :), dampers(:, :, :), own(:, :, :), own_dampers(:, :, :)
    real(wp), allocatable :: seen(:, :), moved(:, :)
    integer :: g, i, n

    n = size(model%mass, 1)
    call set_ok(status)
    if (n > most_coordinates) then
      call fail(status, status_input_error, 'structure', '&structure: has '//show(n) &
                //' coordinates, must have at most '//show(most_coordinates)//' for ' &
                //'characteristic roots (Structure.characteristic_roots in Python has no limit)')
    else if (any([(.not. model%mass(i, i) > 0.0_wp, i=1, n)])) then
      call fail(status, status_input_error, 'mass', 'mass: must be positive for each coordinate ' &
                //'for characteristic roots')
    else if (abs(model%modal%loss) > 0.0_wp) then
      call fail(status, status_input_error, 'loss_factor', 'loss_factor: has no meaning in free ' &
                //'motion, must be 0 for characteristic roots (use a kernel, or modal_damping)')
    end if
    if (status%failed()) return
    call add_linear(model, stiffness, damping)
    damping = model%all_damping()
    if (any(abs(model%modal%ratios) > 0.0_wp)) then
      ! 2 zeta omega of each mode.
      call find_symmetric_modes(model%mass, stiffness, squares, shapes)
      moved = matmul(model%mass, shapes)
      squares = 2.0_wp*model%modal%ratios*sqrt(max(squares, 0.0_wp))
      damping = damping + matmul(moved*spread(squares, 1, n), transpose(moved))
    end if
    call find_springs(system, own, own_dampers)
    seen = matmul(transpose(model%places), model%directions)
    allocate (springs(n, n, 0:ubound(own, 3)), dampers(n, n, 0:ubound(own, 3)))
    do g = 0, ubound(own, 3)
      springs(:, :, g) = matmul(seen, matmul(own(:, :, g), transpose(seen)))
      dampers(:, :, g) = matmul(seen, matmul(own_dampers(:, :, g), transpose(seen)))
    end do
    springs(:, :, 0) = stiffness - sum(springs(:, :, 1:), 3)
    call new_characteristic_matrix(matrix, model%mass, damping, springs, dampers, &
                                   system%kernels, status)
  end subroutine structure_matrix

  !> K_g and C_g of an oscillator, shape (n, n, 0:n_kernels).
  subroutine find_springs(system, stiffness, dampers)
    class(oscillator_type), intent(in) :: system
    real(wp), allocatable, intent(out) :: stiffness(:, :, :), dampers(:, :, :)
    real(wp), allocatable :: slopes(:, :, :), rest(:, :)
    integer :: a, b, g, j, n

    n = system%n_dof()
    allocate (stiffness(n, n, 0:size(system%kernels)), dampers(n, n, 0:size(system%kernels)))
    stiffness = 0.0_wp
    dampers = 0.0_wp
    do j = 1, system%n_memory()
      g = system%kernel_of(j)
      do b = 1, n
        stiffness(:, b, g) = stiffness(:, b, g) + system%spread(:, j)*system%gather(j, b)
      end do
    end do
    if (system%n_rates() == 0) return
    ! Laws with memory contain their linear parts in the rates.
    allocate (rest(1, n + system%n_rates()), source=0.0_wp)
    allocate (slopes(1, system%n_memory(), size(rest, 2)), source=0.0_wp)
    call system%deflection_slopes(rest, slopes)
    do j = 1, system%n_memory()
      g = system%kernel_of(j)
      if (g == 0 .or. .not. system%bent(j)) cycle
      do a = 1, system%n_rates()
        b = system%rates(a)
        dampers(:, b, g) = dampers(:, b, g) + system%spread(:, j)*slopes(1, j, n + a)
      end do
    end do
  end subroutine find_springs

  !> Checked constructor.
  subroutine new_characteristic_matrix(matrix, mass, damping, stiffness, dampers, kernels, status)
    type(characteristic_matrix), intent(out) :: matrix
    !> Shapes (n, n) and (n, n, 0:n_kernels).
    real(wp), intent(in) :: mass(:, :), damping(:, :), stiffness(:, :, 0:), dampers(:, :, 0:)
    type(kernel_holder), intent(in) :: kernels(:)
    type(status_type), intent(out) :: status
    real(wp) :: units(size(mass, 1), size(mass, 1))
    integer, allocatable :: used(:)
    integer :: g, i, n

    call set_ok(status)
    n = size(mass, 1)
    do i = 1, n
      if (.not. mass(i, i) > 0.0_wp) then
        call fail(status, status_input_error, 'mass', 'mass: must be positive definite for ' &
                  //'characteristic roots')
        return
      end if
      units(i, :) = 1.0_wp/sqrt(mass(i, i))
    end do
    units = units*transpose(units)
    used = pack([(g, g=1, size(kernels))], &
                [(any(abs(stiffness(:, :, g)) > 0.0_wp) .or. any(abs(dampers(:, :, g)) > 0.0_wp), &
                  g=1, size(kernels))])
    matrix%mass = mass*units
    matrix%damping = damping*units
    allocate (matrix%stiffness(n, n, 0:size(used)), matrix%dampers(n, n, 0:size(used)))
    matrix%stiffness(:, :, 0) = stiffness(:, :, 0)*units
    matrix%dampers(:, :, 0) = 0.0_wp
    allocate (matrix%kernels(size(used)))
    do i = 1, size(used)
      matrix%stiffness(:, :, i) = stiffness(:, :, used(i))*units
      matrix%dampers(:, :, i) = dampers(:, :, used(i))*units
      allocate (matrix%kernels(i)%kernel, source=kernels(used(i))%kernel)
      matrix%kernels(i)%factor = kernels(used(i))%factor
      matrix%has_table = matrix%has_table .or. is_table(matrix%kernels(i)%kernel)
      matrix%is_symmetric = matrix%is_symmetric .and. is_symmetric(matrix%stiffness(:, :, i)) &
                            .and. is_symmetric(matrix%dampers(:, :, i))
    end do
    matrix%is_symmetric = matrix%is_symmetric .and. is_symmetric(matrix%damping) &
                          .and. is_symmetric(matrix%stiffness(:, :, 0))
    if (size(used) > 0) matrix%cut = minval([(cut_of(matrix%kernels(i)%kernel), i=1, size(used))])
    call find_rates(matrix, status)
    if (matrix%remembers() .and. matrix%is_symmetric .and. .not. status%failed()) then
      call remove_rigid_motions(matrix)
    end if
  end subroutine new_characteristic_matrix

  !> Remove the motions that no spring and no damper resists: rounding errors of det D near its root
  !! 0 would hide the number of all roots.
  subroutine remove_rigid_motions(matrix)
    type(characteristic_matrix), intent(inout) :: matrix
    real(wp), dimension(matrix%n_dof(), matrix%n_dof(), 0:2*size(matrix%stiffness, 3)) :: parts
    real(wp), dimension(matrix%n_dof(), matrix%n_dof()) :: held, shapes
    real(wp), allocatable :: left(:, :)
    real(wp) :: squares(matrix%n_dof())
    logical :: rigid(matrix%n_dof())
    integer, allocatable :: kept(:)
    integer :: g, i, last, n

    n = matrix%n_dof()
    last = ubound(parts, 3)
    parts(:, :, 0) = matrix%damping
    parts(:, :, 1:last:2) = matrix%stiffness
    parts(:, :, 2:last:2) = matrix%dampers
    held = 0.0_wp
    do g = 0, last
      associate (part => parts(:, :, g), largest => maxval(abs(parts(:, :, g))))
        if (largest > 0.0_wp) held = held + matmul(part, part)/largest**2
      end associate
    end do
    call find_symmetric_modes(matrix%mass, held, squares, shapes)
    rigid = squares <= no_square*maxval(squares)
    do g = 0, last
      do i = 1, n
        rigid(i) = rigid(i) .and. .not. any(abs(matmul(parts(:, :, g), shapes(:, i))) > no_force &
                                            *maxval(abs(parts(:, :, g)))*maxval(abs(shapes(:, i))))
      end do
    end do
    matrix%n_rigid = count(rigid)
    if (matrix%n_rigid == 0 .or. matrix%n_rigid == n) return
    kept = pack([(i, i=1, n)], .not. rigid)
    left = shapes(:, kept)
    matrix%mass = seen(matrix%mass)
    matrix%damping = seen(matrix%damping)
    deallocate (matrix%stiffness, matrix%dampers)
    allocate (matrix%stiffness(size(kept), size(kept), 0:last/2 - 1))
    allocate (matrix%dampers(size(kept), size(kept), 0:last/2 - 1))
    do g = 0, last/2 - 1
      matrix%stiffness(:, :, g) = seen(parts(:, :, 2*g + 1))
      matrix%dampers(:, :, g) = seen(parts(:, :, 2*g + 2))
    end do

  contains

    !> A matrix of the remaining motions.
    pure function seen(part)
      real(wp), intent(in) :: part(:, :)
      real(wp) :: seen(size(left, 2), size(left, 2))
      seen = matmul(transpose(left), matmul(part, left))
      seen = 0.5_wp*(seen + transpose(seen))
    end function seen

  end subroutine remove_rigid_motions

  pure logical function is_symmetric(a)
    real(wp), intent(in) :: a(:, :)
    is_symmetric = .not. any(abs(a - transpose(a)) > 0.0_wp)
  end function is_symmetric

  recursive pure logical function is_table(kernel) result(table)
    class(kernel_type), intent(in) :: kernel
    integer :: i
    table = .false.
    select type (kernel)
    type is (tabulated_kernel)
      table = .true.
    type is (kernel_sum)
      table = any([(is_table(kernel%parts(i)%kernel), i=1, size(kernel%parts))])
    end select
  end function is_table

  pure real(wp) function cut_of(kernel)
    class(kernel_type), intent(in) :: kernel
    cut_of = 0.0_wp
    select type (kernel)
    type is (rzhanitsyn_kernel)
      cut_of = kernel%beta
    end select
  end function cut_of

  !> The lowest and the highest rate, positive also at an unstable equilibrium.
  subroutine find_rates(matrix, status)
    type(characteristic_matrix), intent(inout) :: matrix
    type(status_type), intent(inout) :: status
    real(wp), dimension(matrix%n_dof(), matrix%n_dof()) :: factors, stiffness, damping
    complex(wp) :: squares(matrix%n_dof()), rates(matrix%n_dof())
    real(wp) :: present(matrix%n_dof())
    integer :: pivots(matrix%n_dof()), n
    logical :: singular, found, found_too

    n = matrix%n_dof()
    factors = matrix%mass
    stiffness = sum(matrix%stiffness, 3)
    damping = matrix%damping + sum(matrix%dampers, 3)
    call factorize(n, factors, pivots, singular)
    if (singular) then
      call fail(status, status_input_error, 'mass', 'mass: must be positive definite for ' &
                //'characteristic roots')
      return
    end if
    call solve_columns(n, n, factors, pivots, stiffness)
    call solve_columns(n, n, factors, pivots, damping)
    call eigenvalues(stiffness, squares, found)
    call eigenvalues(damping, rates, found_too)
    if (.not. (found .and. found_too)) then
      call fail(status, status_input_error, 'stiffness', 'stiffness: its eigenvalues leave the ' &
                //'range of numbers, choose other units')
      return
    end if
    present = sqrt(abs(squares))
    matrix%fastest = max(maxval(present), maxval(abs(rates)))
    if (.not. matrix%fastest > 0.0_wp) matrix%fastest = 1.0_wp
    if (maxval(present) > 0.0_wp) then
      matrix%slowest = minval(present, present > no_frequency*maxval(present))
    end if
  end subroutine find_rates

  pure integer function n_dof(self)
    class(characteristic_matrix), intent(in) :: self
    n_dof = size(self%mass, 1)
  end function n_dof

  pure logical function remembers(self)
    class(characteristic_matrix), intent(in) :: self
    remembers = size(self%kernels) > 0
  end function remembers

  !> 1 - memory R_g(s), shape (n_kernels, n).
  subroutine retained(self, s, memory, kept)
    class(characteristic_matrix), intent(in) :: self
    complex(wp), intent(in) :: s(:), memory
    complex(wp), intent(out) :: kept(:, :)
    complex(wp) :: transform(size(s))
    integer :: g
    do g = 1, size(self%kernels)
      call self%kernels(g)%laplace(s, transform)
      kept(g, :) = 1.0_wp - memory*transform
    end do
  end subroutine retained

  !> D at s, with the values 1 - R_g(s), shape (n_kernels).
  pure subroutine at(self, s, kept, d)
    class(characteristic_matrix), intent(in) :: self
    complex(wp), intent(in) :: s, kept(:)
    complex(wp), intent(out) :: d(:, :)
    integer :: g, i, j
    do j = 1, size(d, 2)
      do i = 1, size(d, 1)
        d(i, j) = s*(s*self%mass(i, j) + self%damping(i, j)) + self%stiffness(i, j, 0)
      end do
    end do
    do g = 1, size(kept)
      d = d + kept(g)*(self%stiffness(:, :, g) + s*self%dampers(:, :, g))
    end do
  end subroutine at

  !> det D = value 2^power at each s; NaN if a transform overflows.
  subroutine determinants(self, s, memory, value, power)
    class(characteristic_matrix), intent(in) :: self
    complex(wp), intent(in) :: s(:), memory
    complex(wp), intent(out) :: value(:)
    integer, intent(out) :: power(:)
    complex(wp) :: kept(size(self%kernels), size(s)), d(self%n_dof(), self%n_dof())
    integer :: k

    call self%retained(s, memory, kept)
    do k = 1, size(s)
      call self%at(s(k), kept(:, k), d)
      call find_determinant(d, value(k), power(k))
    end do
  end subroutine determinants

  !> Determinant by elimination; the matrix is overwritten.
  pure subroutine find_determinant(d, value, power)
    complex(wp), intent(inout) :: d(:, :)
    complex(wp), intent(out) :: value
    integer, intent(out) :: power
    complex(wp) :: row(size(d, 1)), pivot
    integer :: j, k, n, p

    n = size(d, 1)
    power = 0
    if (n == 2) then
      ! Scaled first to prevent overflow.
      p = exponent(maxval(abs(real(d)) + abs(aimag(d))))
      if (abs(p) > 400) then
        d = cmplx(scale(real(d), -p), scale(aimag(d), -p), wp)
        power = 2*p
      end if
      value = d(1, 1)*d(2, 2) - d(1, 2)*d(2, 1)
      return
    end if
    value = (1.0_wp, 0.0_wp)
    do k = 1, n
      p = k - 1 + maxloc(abs(real(d(k:, k))) + abs(aimag(d(k:, k))), 1)
      if (p /= k) then
        row(k:) = d(p, k:)
        d(p, k:) = d(k, k:)
        d(k, k:) = row(k:)
        value = -value
      end if
      pivot = d(k, k)
      value = value*pivot
      if (.not. abs(value) > 0.0_wp) return
      p = exponent(abs(value))
      value = cmplx(scale(real(value), -p), scale(aimag(value), -p), wp)
      power = power + p
      row(k + 1:) = d(k + 1:, k)/pivot
      do j = k + 1, n
        d(k + 1:, j) = d(k + 1:, j) - row(k + 1:)*d(k, j)
      end do
    end do
  end subroutine find_determinant

  !> All 2 n roots of the system without memory; roots near an axis are placed exactly on it.
  subroutine without_memory(self, roots)
    class(characteristic_matrix), intent(in) :: self
    complex(wp), allocatable, intent(out) :: roots(:)
    real(wp), allocatable :: companion(:, :)
    logical :: found

    call fill_states(self, 0, sum(self%stiffness, 3), companion)
    allocate (roots(size(companion, 1)))
    call eigenvalues(companion, roots, found)
    where (abs(roots) < no_frequency*self%fastest) roots = (0.0_wp, 0.0_wp)
    where (abs(real(roots)) < 1.0e-13_wp*abs(roots)) roots = cmplx(0.0_wp, aimag(roots), wp)
  end subroutine without_memory

  !> State matrix of (u, u') and n_terms n further states; only the rows of u and u' are filled.
  subroutine fill_states(self, n_terms, stiffness, states)
    class(characteristic_matrix), intent(in) :: self
    integer, intent(in) :: n_terms
    real(wp), intent(in) :: stiffness(:, :)
    real(wp), allocatable, intent(out) :: states(:, :)
    real(wp) :: factors(self%n_dof(), self%n_dof()), right(self%n_dof(), 2*self%n_dof())
    integer :: pivots(self%n_dof()), i, n
    logical :: singular

    n = self%n_dof()
    allocate (states((2 + n_terms)*n, (2 + n_terms)*n), source=0.0_wp)
    factors = self%mass
    right(:, :n) = -stiffness
    right(:, n + 1:) = -self%damping - sum(self%dampers, 3)
    call factorize(n, factors, pivots, singular)
    call solve_columns(n, 2*n, factors, pivots, right)
    do i = 1, n
      states(i, n + i) = 1.0_wp
    end do
    states(n + 1:2*n, :2*n) = right
  end subroutine fill_states

  !> True if all kernels are exactly sums of exponentials; total number of terms.
  subroutine is_sum_of_exponentials(self, is_sum, n_terms)
    class(characteristic_matrix), intent(in) :: self
    logical, intent(out) :: is_sum
    integer, intent(out) :: n_terms
    real(wp), allocatable :: weights(:), rates(:)
    integer :: g

    n_terms = 0
    is_sum = .false.
    do g = 1, size(self%kernels)
      if (.not. fades_by_exponentials(self%kernels(g)%kernel)) return
      call self%kernels(g)%exponentials(1.0_wp, 1.0_wp, 1.0_wp, weights, rates)
      n_terms = n_terms + size(weights)
    end do
    is_sum = .true.
  end subroutine is_sum_of_exponentials

  !> The matrix of (u, u', y_q), y_q' = u - r_q y_q for each exponential w_q exp(-r_q t):
  !!
  !!   (K + s C)(1 - w/(s + r)) = K + s C - w C - w (K - r C)/(s + r).
  subroutine state_matrix(self, n_terms, states)
    class(characteristic_matrix), intent(in) :: self
    integer, intent(in) :: n_terms
    real(wp), allocatable, intent(out) :: states(:, :)
    real(wp), dimension(self%n_dof(), self%n_dof()) :: stiffness, pull, factors
    real(wp), allocatable :: weights(:), rates(:)
    integer :: pivots(self%n_dof()), first, g, i, n, q
    logical :: singular

    n = self%n_dof()
    stiffness = sum(self%stiffness, 3)
    do g = 1, size(self%kernels)
      call self%kernels(g)%exponentials(1.0_wp, 1.0_wp, 1.0_wp, weights, rates)
      stiffness = stiffness - sum(weights)*self%dampers(:, :, g)
    end do
    call fill_states(self, n_terms, stiffness, states)
    factors = self%mass
    call factorize(n, factors, pivots, singular)
    first = 2*n
    do g = 1, size(self%kernels)
      call self%kernels(g)%exponentials(1.0_wp, 1.0_wp, 1.0_wp, weights, rates)
      do q = 1, size(weights)
        pull = weights(q)*(self%stiffness(:, :, g) - rates(q)*self%dampers(:, :, g))
        call solve_columns(n, n, factors, pivots, pull)
        states(n + 1:2*n, first + 1:first + n) = pull
        do i = 1, n
          states(first + i, i) = 1.0_wp
          states(first + i, first + i) = -rates(q)
        end do
        first = first + n
      end do
    end do
  end subroutine state_matrix

end module viscovib_characteristic_matrix
